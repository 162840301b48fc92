"""Files and folders that are going to be written: checked before anything is simulated."""

import tempfile
from collections.abc import Sequence
from pathlib import Path


def cannot_write(path: Path, error: OSError) -> OSError:
    """An ``OSError`` that says why ``path`` can't be written and what to do."""
    folder = path.absolute().parent
    advice = "choose a path that you may write" if folder.is_dir() else f"create the folder {folder} first"
    return OSError(f"can't write {path} ({error.strerror or error}): {advice}")


def check_file(path: str | Path, *, suffixes: Sequence[str] = ()) -> Path:
    """A file that can be written (an existing one stays). Raises ValueError: another suffix, OSError: it can't be."""
    path = Path(path)
    if suffixes and path.suffix.lower() not in suffixes:
        raise ValueError(f"{path} must end in {' or '.join(suffixes)}")
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
