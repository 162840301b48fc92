"""Checksums of a recording's pages, in a trailer that HDF5 does not see: it lies beyond the end of its file.

The trailer is the CRC-32 of every page of ``PAGE`` bytes, what is to replace old bytes but may not yet have, and its
own length and CRC-32. Programs that change the file without it (``h5py``) cut it off.
"""

import os
import struct
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

PAGE = 2**16
SEARCHED = (2**20, 2**25, 2**30)  # bytes at the end of a file, for the trailer's own end: it grows with the file
_CHANGE = struct.Struct("<QQ")  # offset and length of the bytes that follow
_FOOT = struct.Struct("<8sQQ")  # magic, where HDF5's file ends, bytes of changes
_CHECK = struct.Struct("<L")  # of all before
_MAGIC = b"MCpages1"
_SUPERBLOCK = struct.Struct("<8sB19xQ")  # signature, version; where HDF5's file ends, in versions 2 and 3
_SIGNATURE, _VERSION = b"\x89HDF\r\n\x1a\n", 2  # the writer's

Change = tuple[int, bytes]  # an offset and what is there


class Trailer(NamedTuple):
    """``end`` of HDF5's file, checksums of its pages, and changes, in order."""

    end: int
    sums: Sequence[int]
    changes: Sequence[Change] = ()

    def pack(self) -> bytes:
        """As it is in the file."""
        changes = b"".join(_CHANGE.pack(at, len(data)) + data for at, data in self.changes)
        body = struct.pack(f"<{len(self.sums)}L", *self.sums) + changes
        body += _FOOT.pack(_MAGIC, self.end, len(changes))
        return body + _CHECK.pack(zlib.crc32(body))


def sealed(content: bytes) -> bytes:
    """A whole HDF5 file with its trailer."""
    sums = [checksum(content[begin : begin + PAGE]) for begin in range(0, len(content), PAGE)]
    return content + Trailer(len(content), sums).pack()


def pages(end: int) -> int:
    """How many pages ``end`` bytes have."""
    return -(-end // PAGE)


def find_trailer(disk: int) -> Trailer | None:
    """That of an open file, or None where it never had one, or was changed by another program.

    Raises:
        ValueError: it is damaged or cut off.
    """
    size = os.fstat(disk).st_size
    head = os.pread(disk, _SUPERBLOCK.size, 0).ljust(_SUPERBLOCK.size, b"\0")
    signature, version, end = _SUPERBLOCK.unpack(head)
    ours = (signature, version) == (_SIGNATURE, _VERSION)
    if ours and end == size:
        return None  # of another program, with what was left of the trailer in it
    found = _unpack(disk, size)
    if found is None and ours:
        raise ValueError("its checksums are missing")
    return found


def _unpack(disk: int, size: int) -> Trailer | None:
    """The last whole one; behind it may be a part of the next, where a writer was stopped, or what others added."""
    for searched in SEARCHED:
        found = _search(disk, max(0, size - searched), size)
        if found is not None or searched >= size:
            return found
    return None


def _search(disk: int, begin: int, size: int) -> Trailer | None:
    """The last whole one whose end lies behind ``begin``."""
    tail = os.pread(disk, size - begin, begin)
    at = len(tail)
    while (at := tail.rfind(_MAGIC, 0, at)) >= 0:
        if at + _FOOT.size + _CHECK.size > len(tail):
            continue
        _, end, changed = _FOOT.unpack_from(tail, at)
        start = begin + at - changed - 4 * pages(end)
        if start < end:
            continue
        body = os.pread(disk, begin + at + _FOOT.size - start, start)
        if zlib.crc32(body) == _CHECK.unpack_from(tail, at + _FOOT.size)[0]:
            count = pages(end)
            return Trailer(end, struct.unpack_from(f"<{count}L", body), list(_changes(body[4 * count : -_FOOT.size])))
    return None


def _changes(body: bytes) -> Iterator[Change]:
    begin = 0
    while begin < len(body):
        at, length = _CHANGE.unpack_from(body, begin)
        begin += _CHANGE.size + length
        yield at, body[begin - length : begin]


def overlay(out: memoryview | bytearray, begin: int, changes: Iterable[Change]) -> None:
    """Put into ``out``, which is the file from ``begin`` on, what of ``changes`` falls into it."""
    for at, data in changes:
        first, last = max(at, begin), min(at + len(data), begin + len(out))
        if first < last:
            out[first - begin : last - begin] = data[first - at : last - at]


def by_page(changes: Iterable[Change]) -> Mapping[int, list[Change]]:
    """The changes that touch each page."""
    found: dict[int, list[Change]] = {}
    for at, data in changes:
        for page in range(at // PAGE, pages(at + len(data))):
            found.setdefault(page, []).append((at, data))
    return found


def checksum(page: bytes | bytearray | memoryview) -> int:
    """What the trailer keeps of a page."""
    return zlib.crc32(page)
