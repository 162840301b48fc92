"""An HDF5 file that is read while it may be damaged, closed, or still being written."""

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import h5py

from cloth_envs.files import first_line
from cloth_envs.recording.image import Image

T = TypeVar("T")
TRIES = 100  # a writer that commits faster than a frame is read


class CheckedFile:
    """``path`` opened for reading; ``read`` gives what no writer has touched meanwhile, or ValueError.

    Raises:
        PermissionError: it may not be read.
        ValueError: no HDF5 file, or cut short.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file: h5py.File | None = None
        self._counter: int | None = None
        self._open()
        assert self._file is not None
        if isinstance(self._file.get("commits"), h5py.Dataset):
            self._counter = self._file["commits"].id.get_offset()
            self._open()  # now that it is known how to tell that a writer came between

    def _open(self) -> None:
        self.close()
        try:
            self._image = Image(self.path)
            self._seen = self._commits()
            self._file = h5py.File(self._image, "r")
        except PermissionError:
            raise
        except Exception as error:
            raise ValueError(
                f"{self.path} is no HDF5 file or was cut short ({first_line(error)}): copy or record it again"
            ) from error

    def _commits(self) -> int:
        return 0 if self._counter is None else self._image.count(self._counter)

    def read(self, look: Callable[[h5py.File], T]) -> T:
        """What ``look`` finds in the file; it is called again if a writer came between.

        Raises:
            ValueError: damaged, or closed.
        """
        for _ in range(TRIES):
            if self._file is None:
                raise ValueError(f"{self.path} has been closed: open it again with Rollout.open")
            failed: Exception | None = None
            try:
                found = look(self._file)
            except Exception as error:  # of a damaged file h5py raises almost anything
                failed = error
            if self._commits() != self._seen:
                self._open()
            elif failed is None:
                return found
            else:
                break
        told = first_line(failed or TimeoutError("its writer is faster"))
        raise ValueError(f"{self.path} is damaged ({told}): copy or record it again") from failed

    def close(self) -> None:
        """Close it; again does nothing."""
        if self._file is not None:
            self._file.close()
            self._image.close()
            self._file = None
