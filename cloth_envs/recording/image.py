"""The file that HDF5 writes to and reads from: changes go to the disk all at once, and never fail inside HDF5.

libhdf5 can't stand a failed write (its next close ends in a segmentation fault, h5py #914). So it is given this object
in place of a file: what it writes stays in memory until ``commit``, which appends new bytes, then a journal of those
that replace old ones, and then replaces them. A writer that is killed or that finds the disk full leaves the file as
the last commit made it; one that is stopped between journal and replacing leaves the journal, which ``Image`` applies.
Without a journal at its end the file is plain HDF5.
"""

import errno
import io
import os
import struct
import sys
import zlib
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

_CHANGE = struct.Struct("<QQ")  # offset and length of the bytes that follow
_END = struct.Struct("<8sQL")  # closes a journal: magic, its length, its CRC-32
_MAGIC = b"MCjournl"
_COUNT = struct.Struct("<q")


class Image(io.RawIOBase):
    """A file object for ``h5py.File``; ``writer``: a file to be made, or emptied if ``path`` exists.

    Raises:
        OSError: it can't be opened, or another writer has it open.
    """

    def __init__(self, path: Path, *, writer: bool = False) -> None:
        self.path, self._writer, self._owner = path, writer, os.getpid()
        self.counter: int | None = None  # where the number of commits is
        self.commits = 0
        self._disk = path.open(("r+b" if path.exists() else "x+b") if writer else "rb", buffering=0)
        self._changes: list[tuple[int, bytes]] = []  # what the disk does not have, in order
        self._at = self._size = self._end = 0
        self.failed: OSError | None = None  # what a read met, of which HDF5 must not know
        if writer:
            try:
                lock(self._disk)
            except OSError:
                self._disk.close()
                raise
            self._disk.truncate(0)
        else:
            self._read_journal()

    @property
    def mine(self) -> bool:
        """Whether this process opened it, and not one of which it is a fork."""
        return os.getpid() == self._owner

    def _read_journal(self) -> None:
        whole = self._size = self._disk.seek(0, os.SEEK_END)
        tail = self._from_disk(max(0, whole - _END.size), _END.size)
        if len(tail) < _END.size:
            return
        magic, length, check = _END.unpack(tail)
        begin = whole - _END.size - length
        if magic != _MAGIC or begin < 0:
            return
        body = self._from_disk(begin, length)
        if zlib.crc32(body) == check:
            self._changes, self._size = list(_changes(body)), begin

    def _from_disk(self, offset: int, length: int) -> bytes:
        self._disk.seek(offset)
        return self._disk.read(length)

    def _put(self, offset: int, data: bytes) -> None:
        self._disk.seek(offset)
        rest = memoryview(data)
        while rest:
            rest = rest[self._disk.write(rest) :]

    def commit(self) -> None:
        """Put what was written since the last time onto the disk, whole or not at all.

        Raises:
            OSError: it can't be; nothing of it counts.
        """
        if not self.mine:
            raise OSError(errno.EBUSY, "the process that this is a fork of has it open")
        old = [(at, data) for at, data in self._changes if at < self._end]
        new = [(at, data) for at, data in self._changes if at >= self._end]
        last = max(self._end, self._size)
        if self.failed is not None:
            raise self.failed
        try:
            if not _same(self._disk, self.path):
                raise FileNotFoundError(errno.ENOENT, "it was removed or replaced meanwhile")
            self._disk.truncate(self._end)  # less the journal before
            for at, data in new:
                self._put(at, data)
            self._disk.truncate(last)
            body = b"".join(_CHANGE.pack(at, len(data)) + data for at, data in old)
            self._put(last, body + _END.pack(_MAGIC, len(body), zlib.crc32(body)))
        except OSError:
            with suppress(OSError):
                self._disk.truncate(self._end)
            raise
        if self.counter is not None:  # first of all, so that a reader who saw any change finds another number
            self.commits += 1
            self._put(self.counter, _COUNT.pack(self.commits))
        for at, data in old:
            self._put(at, data)
        self._end, self._changes = last, []

    def finish(self) -> None:
        """Commit, and leave plain HDF5. Raises OSError: it can't be."""
        self.commit()
        self._disk.truncate(self._size)
        os.fsync(self._disk.fileno())

    def count(self, offset: int) -> int:
        """How many commits the disk has seen, of which HDF5 keeps the number at ``offset``."""
        data = self._from_disk(offset, _COUNT.size)
        return int(_COUNT.unpack(data)[0]) if len(data) == _COUNT.size else -1

    def close(self) -> None:
        self._disk.close()
        super().close()

    # What HDF5 calls.

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        self._at = offset + {os.SEEK_SET: 0, os.SEEK_CUR: self._at, os.SEEK_END: self._size}[whence]
        return self._at

    def tell(self) -> int:
        return self._at

    def readinto(self, buffer: Any) -> int:
        out, begin = memoryview(buffer).cast("B"), self._at
        try:
            found = self._from_disk(begin, len(out))
        except OSError as error:
            if not self._writer:
                raise
            found, self.failed = b"", error
        out[: len(found)] = found
        out[len(found) :] = bytes(len(out) - len(found))
        for at, data in self._changes:
            first, last = max(at, begin), min(at + len(data), begin + len(out))
            if first < last:
                out[first - begin : last - begin] = data[first - at : last - at]
        self._at += len(out)
        return len(out)

    def write(self, buffer: Any) -> int:
        data, at = bytes(buffer), self._at
        inside = max(0, self._end - at)  # so many bytes replace old ones
        if 0 < inside < len(data):
            self._changes += [(at, data[:inside]), (at + inside, data[inside:])]
        else:
            self._changes.append((at, data))
        self._at += len(data)
        self._size = max(self._size, self._at)
        return len(data)

    def truncate(self, size: int | None = None) -> int:
        self._size = self._at if size is None else size
        return self._size

    def readable(self) -> bool:
        return True

    def writable(self) -> bool:
        return self._writer

    def seekable(self) -> bool:
        return True


def _changes(body: bytes) -> Iterator[tuple[int, bytes]]:
    begin = 0
    while begin < len(body):
        at, length = _CHANGE.unpack_from(body, begin)
        begin += _CHANGE.size + length
        yield at, body[begin - length : begin]


def _same(file: Any, path: Path) -> bool:
    """Whether ``path`` still is the open ``file``."""
    return path.exists() and os.path.samestat(os.fstat(file.fileno()), path.stat())


def lock(file: Any) -> None:
    """Keep other writers off an open file until it is closed, where the system has such locks.

    Raises:
        BlockingIOError: another writer has it.
    """
    if sys.platform == "win32":
        return
    import fcntl

    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise BlockingIOError(error.errno, "another writer has it open") from error
    except OSError:
        return  # a file system without locks
