"""Files and folders that are written: checked before anything is simulated, and replaced whole or not at all."""

import errno
import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}


def cannot_write(path: str | Path, error: OSError, kept: str = "") -> OSError:
    """An ``OSError`` that says why ``path`` can't be written, what to do, and what is ``kept`` all the same."""
    folder = Path(path).absolute().parent
    if not folder.is_dir():
        advice = f"create the folder {folder} first"
    elif error.errno in FULL:
        advice = "free some space, or choose a path on another disk"
    elif Path(path).exists() and not Path(path).is_file():
        advice = "it is no ordinary file, choose a path that is none or one"
    else:
        advice = "choose a path that you may write"
    told = OSError(f"can't write {path} ({error.strerror or error}): {advice}{kept and f'; {kept}'}")
    told.errno = error.errno
    return told


def final_path(path: str | Path) -> Path:
    """Where what is written to ``path`` ends up: links followed. Raises OSError: a folder, a device, or read-only."""
    target = Path(os.path.realpath(path))
    if target.exists() and not target.is_file():
        raise cannot_write(path, OSError(errno.EINVAL, "a folder" if target.is_dir() else "a device"))
    if target.exists() and not os.access(target, os.W_OK):
        raise cannot_write(path, PermissionError(errno.EACCES, "read-only"))
    return target


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """A path beside ``path`` to write to; what is there when the block ends takes the place of ``path``.

    Whatever fails in between, ``path`` stays as it was and nothing is left beside it.

    Raises:
        OSError: it can't be written; names ``path`` and says why.
    """
    target = final_path(path)
    part = target.with_name(f"{target.stem}.{os.getpid()}.part{target.suffix}")
    try:
        yield part
        with part.open("r+b") as file:
            os.fsync(file.fileno())
        part.replace(target)
    except OSError as error:
        raise cannot_write(path, error) from error
    finally:
        part.unlink(missing_ok=True)


def write_text(path: str | Path, text: str) -> None:
    """``text`` in UTF-8 in place of what is there. Raises OSError: it can't be written; the old file stays."""
    with replacing(path) as part:
        part.write_text(text, encoding="utf-8")


def check_file(path: str | Path, *, suffixes: Sequence[str] = ()) -> Path:
    """A file that can be written (an existing one stays). Raises ValueError: another suffix, OSError: it can't be."""
    path = Path(path)
    if suffixes and path.suffix.lower() not in suffixes:
        raise ValueError(f"{path} must end in {' or '.join(suffixes)}")
    final_path(path)
    existed = path.exists()
    try:
        with path.open("ab"):
            pass
    except OSError as error:
        raise cannot_write(path, error) from error
    if not existed:
        path.unlink()
    return path


def check_folder(path: str | Path) -> Path:
    """A folder that can be written, made if need be. Raises OSError: it can't be made or written."""
    path = Path(path)
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            pass
    except OSError as error:
        raise OSError(f"can't write into {path} ({error.strerror}): choose a folder that you may write") from error
    return path
