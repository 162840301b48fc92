"""An HDF5 file that is read while it may be damaged, closed, used by several threads, or still being written."""

import os
import weakref
from collections.abc import Callable
from pathlib import Path
from threading import RLock
from time import sleep
from typing import TypeVar

import h5py

from cloth_envs.files import first_line
from cloth_envs.recording.stored import StoredFile

T = TypeVar("T")
_OPEN: "weakref.WeakSet[CheckedFile]" = weakref.WeakSet()
TRIES = 100  # a writer that commits faster than a frame is read
WAITS = (0.001, 0.002, 0.004, 0.008)  # [s] for a writer that is committing just now


class CheckedFile:
    """``path`` opened for reading; ``read`` gives what no writer has touched meanwhile, or ValueError.

    Raises:
        OSError: it can't be opened or read.
        ValueError: no HDF5 file, damaged, or cut short.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock = RLock()
        _OPEN.add(self)
        self._file: h5py.File | None = None
        self._counter: int | None = None
        self._open()
        assert self._file is not None
        if isinstance(self._file.get("commits"), h5py.Dataset):
            self._counter = self._file["commits"].id.get_offset()
            self._open()  # now that it is known how to tell that a writer came between

    def _open(self) -> None:
        self.close()
        for wait in (*WAITS, None):
            try:
                self._open_once()
            except ValueError:
                if wait is None:
                    raise
                sleep(wait)
            else:
                break

    def _open_once(self) -> None:
        image: StoredFile | None = None
        try:
            image = StoredFile(self.path)
            self._seen = self._commits(image)
            self._file = h5py.File(image, "r")
        except Exception as error:
            if image is not None:
                image.close()
            if self.path.is_file() and not self.path.stat().st_size:
                raise ValueError(
                    f"{self.path} is empty, its writer has flushed nothing yet or was killed: read it later, or "
                    "record it again"
                ) from None
            cause = error if image is None else image.failed
            if isinstance(cause, OSError):
                raise cause from None
            raise ValueError(
                f"{self.path} is no HDF5 file, is damaged or was cut short ({first_line(error)}): "
                "copy or record it again"
            ) from error
        self._image = image
        self._finish = weakref.finalize(self, _close, self._file, image)

    def _commits(self, image: StoredFile) -> int:
        return 0 if self._counter is None else image.count(self._counter)

    def read(self, look: Callable[[h5py.File], T]) -> T:
        """What ``look`` finds in the file; it is called again if a writer came between. One thread at a time.

        Raises:
            OSError: the disk can't be read.
            ValueError: damaged, or closed.
        """
        with self._lock:
            for _ in range(TRIES):
                self.check_open()
                failed: Exception | None = None
                try:
                    found = look(self._file)
                except Exception as error:  # of a damaged file h5py raises almost anything
                    failed = error
                if self._image.failed is not None:
                    raise self._image.failed from None
                if self._commits(self._image) != self._seen:
                    self._open()
                elif failed is None:
                    return found
                else:
                    break
        told = first_line(failed or TimeoutError("its writer is faster"))
        raise ValueError(f"{self.path} is damaged ({told}): copy or record it again") from failed

    def check_open(self) -> None:
        """Raises ValueError: closed."""
        if self._file is None:
            raise ValueError(f"{self.path} has been closed: open it again with Rollout.open")

    def close(self) -> None:
        """Close it, when no thread reads it; again does nothing."""
        with self._lock:
            if self._file is not None:
                self._finish()
                self._file = None


def _forked() -> None:
    """In a new child: the thread that held a lock is not there."""
    for file in _OPEN:
        file._lock = RLock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forked)


def _close(file: h5py.File, image: StoredFile) -> None:
    """Close both; a forgotten file's with the program, while HDF5 can still call Python."""
    file.close()
    image.close()
