"""Locks on open files and folders, which end with the program that holds them; none where the system has none."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from cloth_envs.files import WriteError, check_folder


def lock(file: Any) -> None:
    """Keep other writers off an open file until it is unlocked or closed.

    Raises:
        BlockingIOError: another program has it.
    """
    if sys.platform == "win32":
        return
    import fcntl

    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise BlockingIOError(error.errno, "another program has it open") from error
    except OSError:
        return  # a file system without locks


def unlock(file: Any) -> None:
    """Let others write, also where a fork of this process has the same file open."""
    if sys.platform == "win32":
        return
    import fcntl

    with suppress(OSError):  # a file system without locks, or a disk that is gone
        fcntl.flock(file, fcntl.LOCK_UN)


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Have a folder, made if need be, for this program alone, among those that ask, until the block ends.

    Raises:
        OSError: another program has it, or it can't be made or written.
    """
    check_folder(folder)
    if sys.platform == "win32":  # where a folder can't be opened
        yield
        return
    opened = os.open(folder, os.O_RDONLY)
    try:
        lock(opened)
    except BlockingIOError as error:
        os.close(opened)
        raise WriteError(
            f"another program writes into {folder}: let that end first, or choose another folder"
        ) from error
    try:
        yield
    finally:
        unlock(opened)
        os.close(opened)
