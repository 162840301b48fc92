"""HDF5's global heaps, where texts without a fixed length are, in files that have no checksums of their pages."""

import mmap
import os
import struct

_MAGIC = b"GCOL"
_COLLECTION = struct.Struct("<4sB3xQ")  # magic, version, size
_OBJECT = struct.Struct("<HH4xQ")  # number, references, size


def check_heaps(disk: int) -> None:
    """That HDF5 comes to the end of every heap in an open file: it stays for ever at a free space of no bytes.

    Raises:
        ValueError: it does not.
    """
    if os.fstat(disk).st_size == 0:
        return
    with mmap.mmap(disk, 0, access=mmap.ACCESS_READ) as content:
        at = -1
        while (at := content.find(_MAGIC, at + 1)) >= 0:
            if not _ends(content, at):
                raise ValueError(f"the heap at {at} has no end")


def _ends(content: mmap.mmap, begin: int) -> bool:
    if begin + _COLLECTION.size > len(content):
        return True
    _, version, size = _COLLECTION.unpack_from(content, begin)
    end, at = begin + size, begin + _COLLECTION.size
    if version != 1 or end > len(content):
        return True  # HDF5 says so itself
    while at + _OBJECT.size <= end:
        number, _, length = _OBJECT.unpack_from(content, at)
        if number == 0 and length == 0:
            return False
        at += length if number == 0 else _OBJECT.size + -(-length // 8) * 8
    return True
