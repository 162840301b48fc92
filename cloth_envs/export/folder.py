"""A folder of numbered files, replaced as a whole."""

import os
import re
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from cloth_envs.files import WriteError, cannot_write, check_folder


@contextmanager
def replacing_frames(folder: Path, suffix: str) -> Iterator[Callable[[str, int, bytes], Path]]:
    """What writes ``cloth_00000.ply`` for ``("cloth", 0, data)``, and returns that path.

    The new files take the place of all ``cloth_*`` and ``bodies_*`` frames of this ``suffix`` when the block ends;
    other files stay. Whatever fails before, the folder stays as it was.

    Raises:
        OSError: the folder or a file can't be written; names it and says why.
    """
    if folder.exists() and not folder.is_dir():
        raise WriteError(
            f"can't write frames into the folder {folder}, which is a file: move that away, or choose another name"
        )
    existed = folder.exists()
    check_folder(folder)
    new: list[str] = []
    try:
        with tempfile.TemporaryDirectory(prefix="export.", suffix=".part", dir=folder) as part:

            def add(name: str, number: int, data: bytes) -> Path:
                path = folder / f"{name}_{number:05d}{suffix}"
                try:
                    with (Path(part) / path.name).open("wb") as file:
                        file.write(data)
                        file.flush()
                        os.fsync(file.fileno())
                except OSError as error:
                    raise cannot_write(path, error) from error
                new.append(path.name)
                return path

            yield add
            _put(Path(part), folder, new, re.compile(rf"(cloth|bodies)_\d{{5,}}{re.escape(suffix)}"))
    finally:
        if not existed:
            with suppress(OSError):  # it holds the frames
                folder.rmdir()


def _put(part: Path, folder: Path, new: list[str], frames: re.Pattern[str]) -> None:
    """Move the ``new`` files from ``part`` into ``folder``, and remove what else looks like ``frames``."""
    for name in new:
        try:
            (part / name).replace(folder / name)
        except OSError as error:
            raise cannot_write(folder / name, error) from error
    for old in list(folder.iterdir()):
        if frames.fullmatch(old.name) and old.name not in new and old.is_file():
            old.unlink()
