"""The file that HDF5 reads from: not a byte of it reaches HDF5 that does not have its checksum.

libhdf5 reads some damaged files for ever, inside one call, and takes a page of zeros for good: its Fletcher-32 of
zeros is 0.
"""

import io
import os
import struct
from pathlib import Path
from typing import Any

from cloth_envs.recording.heaps import check_heaps
from cloth_envs.recording.pages import PAGE, Change, Trailer, by_page, checksum, find_trailer, overlay

KEPT_PAGES = 32  # in memory, of those read last


class StoredFile(io.RawIOBase):
    """A recording as a file object for ``h5py.File``, whole although its writer may have been stopped anywhere.

    Positions are of no one else's: forked processes read each its own.

    Raises:
        OSError: it can't be opened.
        ValueError: its checksums are damaged or cut off; it has none, and HDF5 would read it for ever.
    """

    def __init__(self, path: Path) -> None:
        self.failed: OSError | None = None  # what a read met; HDF5 tells what it made of it
        self._at = 0
        self._pages: dict[int, bytes] = {}
        self._disk = os.open(path, os.O_RDONLY | getattr(os, "O_BINARY", 0))
        try:
            trailer = find_trailer(self._disk)
            if trailer is None:
                check_heaps(self._disk)
        except (OSError, ValueError):
            self.close()
            raise
        self._sums = None if trailer is None else trailer.sums
        trailer = trailer or Trailer(os.fstat(self._disk).st_size, ())
        self._size = trailer.end
        self._changes: dict[int, list[Change]] = dict(by_page(trailer.changes))

    def _page(self, number: int) -> bytes:
        """Raises ValueError: it does not have its checksum, OSError: it can't be read."""
        found = self._pages.get(number)
        if found is None:
            begin = number * PAGE
            content = bytearray(min(PAGE, self._size - begin))
            data = os.pread(self._disk, len(content), begin)
            content[: len(data)] = data
            overlay(content, begin, self._changes.get(number, ()))
            if self._sums is not None and checksum(content) != self._sums[number]:
                raise ValueError(f"the {PAGE} bytes from {begin} on do not have their checksum")
            found = bytes(content)
            if len(self._pages) >= KEPT_PAGES:
                self._pages.pop(next(iter(self._pages)), None)
            self._pages[number] = found
        return found

    def count(self, offset: int) -> int:
        """The whole number at ``offset`` as it is on the disk now."""
        data = os.pread(self._disk, 8, offset)
        return int(struct.unpack("<q", data)[0]) if len(data) == 8 else -1

    def close(self) -> None:
        if not self.closed:
            os.close(self._disk)
        super().close()

    # What HDF5 calls.

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        self._at = offset + {os.SEEK_SET: 0, os.SEEK_CUR: self._at, os.SEEK_END: self._size}[whence]
        return self._at

    def tell(self) -> int:
        return self._at

    def readinto(self, buffer: Any) -> int:
        """Beyond the end are zeros."""
        out = memoryview(buffer).cast("B")
        begin, done = self._at, 0
        try:
            while done < len(out) and begin + done < self._size:
                number, inside = divmod(begin + done, PAGE)
                data = self._page(number)[inside : inside + len(out) - done]
                out[done : done + len(data)] = data
                done += len(data)
        except OSError as error:
            self.failed = error
            raise
        out[done:] = bytes(len(out) - done)
        self._at += len(out)
        return len(out)

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True
