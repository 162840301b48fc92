"""Files and folders that are written: checked before anything is simulated, and replaced whole or not at all."""

import errno
import json
import os
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from zipfile import BadZipFile, ZipFile

FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
NAMES = {errno.ENAMETOOLONG, errno.EILSEQ}
MANY = {errno.EMFILE, errno.ENFILE}


class WriteError(OSError):
    """An ``OSError`` that says all that there is to say."""


def cannot_write(path: str | Path, error: OSError, kept: str = "") -> OSError:
    """An ``OSError`` that says why ``path`` can't be written, what to do, and what is ``kept`` all the same."""
    if error.errno == errno.ESTALE:
        advice = "start again, and leave the file where it is"
    elif error.errno in NAMES:
        advice = "choose another name"
    elif not (folder := Path(os.path.realpath(path)).parent).is_dir():
        advice = f"create the folder {folder} first"
    elif error.errno in FULL:
        advice = "free some space, or choose a path on another disk"
    elif Path(path).exists() and not Path(path).is_file():
        advice = "choose a path that is no folder and no device"
    elif error.errno in MANY:
        advice = "close other files first"
    elif error.errno in (errno.EAGAIN, errno.EBUSY):
        advice = "let that end first, or choose another path"
    else:
        advice = "choose a path that you may write"
    told = WriteError(f"can't write {path} ({error.strerror or error}): {advice}{kept and f'; {kept}'}")
    told.errno = error.errno
    return told


def final_path(path: str | Path) -> Path:
    """Where what is written to ``path`` ends up: links followed. Raises OSError: a folder, a device, or read-only."""
    if "\0" in str(path):
        raise cannot_write(path, OSError(errno.EILSEQ, "a name with a null byte"))
    target = Path(os.path.realpath(path))
    try:
        target.lstat()
    except OSError as error:
        if error.errno in NAMES:
            raise cannot_write(path, error) from error
    if target.exists() and not target.is_file():
        raise cannot_write(path, OSError(errno.EINVAL, "a folder" if target.is_dir() else "a device"))
    if target.exists() and not os.access(target, os.W_OK):
        raise cannot_write(path, PermissionError(errno.EACCES, "read-only"))
    return target


@contextmanager
def replacing(path: str | Path, *, suffix: bool = True) -> Iterator[Path]:
    """A path beside ``path`` to write to; what is there when the block ends takes the place of ``path``.

    It ends in the ``suffix`` of ``path`` where a library tells the format by that, otherwise in ``.part``: what a
    killed process leaves is taken for no file of the kind then.

    Whatever fails in between, ``path`` stays as it was and nothing is left beside it.

    Raises:
        OSError: it can't be written; names ``path`` and says why.
    """
    target = final_path(path)
    part = target.with_name(f"{target.name}.{os.getpid()}.part{target.suffix if suffix else ''}")
    try:
        yield part
        with part.open("r+b") as file:
            os.fsync(file.fileno())
        if target.exists():
            shutil.copymode(target, part)
        part.replace(target)
    except WriteError:  # of another file, on the way
        raise
    except OSError as error:
        raise cannot_write(path, error) from error
    finally:
        part.unlink(missing_ok=True)


def why_cut(part: Path, otherwise: str) -> OSError:
    """What kept a library from writing all of ``part``: what keeps us from it too, or ``otherwise``."""
    try:
        with part.open("ab", buffering=0) as file:
            file.write(bytes(2**20))
            os.fsync(file.fileno())
            file.write(bytes(1))
    except OSError as error:
        return error
    return OSError(otherwise)


def write_bytes(path: str | Path, data: bytes) -> None:
    """``data`` in place of what is there. Raises OSError: it can't be written; the old file stays."""
    with replacing(path, suffix=False) as part:
        part.write_bytes(data)


def write_text(path: str | Path, text: str) -> None:
    """``text`` in UTF-8 in place of what is there. Raises OSError: it can't be written; the old file stays."""
    write_bytes(path, text.encode())


def first_line(error: Exception) -> str:
    """What an error says, short."""
    return next(iter(str(error).strip().splitlines()), type(error).__name__)


@contextmanager
def reading(path: str | Path, remedy: str) -> Iterator[None]:
    """Whatever reading a damaged file raises becomes an error that names it.

    Raises:
        OSError: as it is: what the system says of a file that it can't open, or of a disk that it can't read.
        ValueError: names ``path`` and the ``remedy``.
    """
    try:
        yield
    except Exception as error:
        if isinstance(error, OSError) and error.errno not in (None, errno.EINVAL):  # those come of what is in it
            raise
        raise ValueError(f"{path} is damaged ({first_line(error)}): {remedy}") from error


def read_json(path: str | Path, *keys: str, remedy: str) -> dict[str, Any]:
    """A JSON object that has ``keys``. Raises ValueError: it is none; names ``path`` and the ``remedy``."""
    with reading(path, remedy):
        found: dict[str, Any] = json.loads(Path(path).read_text(encoding="utf-8"))
        missing = [key for key in keys if key not in dict(found)]
        if missing:
            raise ValueError(f"it has no {missing[0]!r}")
    return found


def check_zip(path: str | Path) -> None:
    """That every member of a zip file (``.npz``, ``.pt``) has its checksum. Raises BadZipFile: one has not."""
    with ZipFile(path) as archive:
        broken = archive.testzip()
    if broken is not None:
        raise BadZipFile(f"{broken} does not have its checksum")


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
        raise WriteError(f"can't write into {path} ({error.strerror}): choose a folder that you may write") from error
    return path
