"""The file that HDF5 writes to: changes go to the disk all at once, and never fail inside HDF5.

libhdf5 can't stand a failed write (its next close ends in a segmentation fault, h5py #914). So it is given this object
in place of a file: what it writes stays in memory until ``commit``. Beyond HDF5's file, where HDF5 does not look, is a
trailer with the checksums of its pages. A commit puts that behind where the new bytes go, then the new bytes, then the
next trailer, which holds those that replace old ones too: from then on it counts, for all who read with ``StoredFile``.
Then it replaces the old bytes, and moves the trailer to its place. The file ends in a whole trailer all the time, so
that a writer that is killed or finds the disk full leaves the file as the last commit made it.
"""

import errno
import io
import os
import struct
from contextlib import suppress
from pathlib import Path
from typing import Any

from cloth_envs.locks import lock, unlock
from cloth_envs.recording.pages import PAGE, Change, Trailer, by_page, checksum, overlay, pages

_COUNT = struct.Struct("<q")


class Image(io.RawIOBase):
    """A file object for ``h5py.File`` to write to: a file that is made, or emptied if ``path`` exists.

    Raises:
        OSError: it can't be opened, or another program has it open.
    """

    def __init__(self, path: Path) -> None:
        self.path, self._owner = path, os.getpid()
        self.counter: int | None = None  # where the number of commits is
        self.commits = 0
        self._disk = path.open("r+b" if path.exists() else "x+b", buffering=0)
        self._changes: list[Change] = []  # what the disk does not have, in order
        self._at = self._size = self._end = 0
        self._sums: list[int] = []  # of the pages up to _end
        self.failed: OSError | None = None  # what a read met, of which HDF5 must not know
        try:
            lock(self._disk)
        except OSError:
            self._disk.close()
            raise
        self._disk.truncate(0)

    @property
    def there(self) -> bool:
        """Whether the file still has its name."""
        return _same(self._disk, self.path)

    @property
    def mine(self) -> bool:
        """Whether this process opened it, and not one of which it is a fork."""
        return os.getpid() == self._owner

    def _put(self, offset: int, data: bytes) -> None:
        rest = memoryview(data)
        while rest:
            done = os.pwrite(self._disk.fileno(), rest, offset)
            rest, offset = rest[done:], offset + done

    def commit(self) -> None:
        """Put what was written since the last time onto the disk, whole or not at all.

        Raises:
            OSError: it can't be; nothing of it counts.
        """
        if not self.mine:
            raise OSError(errno.EBUSY, "the process that this is a fork of has it open")
        if self.failed is not None:
            raise self.failed
        if not self.there:
            raise OSError(errno.ESTALE, "it was removed or replaced meanwhile")
        if self.counter is not None:
            self._changes.append((self.counter, _COUNT.pack(self.commits + 1)))
        last = max(self._end, self._size)
        old = [(at, data) for at, data in self._changes if at < self._end]
        sums = self._new_sums(last)
        before = Trailer(self._end, self._sums).pack() if self._end else b""
        after = Trailer(last, sums).pack()
        whole = os.fstat(self._disk.fileno()).st_size  # what counts if anything fails
        copy = max(last + len(after), whole)
        try:
            self._put(copy, before)
            whole = copy + len(before) if before else whole
            for at, data in self._changes:
                if at >= self._end:
                    self._put(at, data)
            self._put(copy + len(before), Trailer(last, sums, old).pack())
        except OSError:
            with suppress(OSError):
                self._disk.truncate(whole)
            raise
        self.commits += 1
        for at, data in old[-1:] + old:  # the counter first, so that a reader who saw any change finds another number
            self._put(at, data)
        self._put(last, after)
        self._disk.truncate(last + len(after))
        self._end, self._sums, self._changes = last, sums, []

    def _new_sums(self, last: int) -> list[int]:
        """Of the pages of ``last`` bytes, with the changes."""
        touched, sums = by_page(self._changes), self._sums + [0] * (pages(last) - len(self._sums))
        for number in {*touched, *range(self._end // PAGE, len(sums))}:
            begin = number * PAGE
            content = bytearray(min(PAGE, last - begin))
            data = os.pread(self._disk.fileno(), max(0, min(len(content), self._end - begin)), begin)
            content[: len(data)] = data
            overlay(content, begin, touched.get(number, ()))
            sums[number] = checksum(content)
        return sums

    def finish(self) -> None:
        """Commit, for good. Raises OSError: it can't be."""
        self.commit()
        os.fsync(self._disk.fileno())

    def close(self) -> None:
        """Close it; other programs may write to it then, although a fork of this process has it open too."""
        if self.mine and not self._disk.closed:
            unlock(self._disk)
        self._disk.close()
        super().close()

    # What HDF5 calls.

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        self._at = offset + {os.SEEK_SET: 0, os.SEEK_CUR: self._at, os.SEEK_END: self._size}[whence]
        return self._at

    def tell(self) -> int:
        return self._at

    def readinto(self, buffer: Any) -> int:
        out = memoryview(buffer).cast("B")
        try:
            found = os.pread(self._disk.fileno(), max(0, min(len(out), self._end - self._at)), self._at)
        except OSError as error:
            found, self.failed = b"", error
        out[: len(found)] = found
        out[len(found) :] = bytes(len(out) - len(found))
        overlay(out, self._at, self._changes)
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
        return True

    def seekable(self) -> bool:
        return True


def _same(file: Any, path: Path) -> bool:
    """Whether ``path`` still is the open ``file``."""
    return path.exists() and os.path.samestat(os.fstat(file.fileno()), path.stat())
