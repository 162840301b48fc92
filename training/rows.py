"""Rows on disk: a benchmark that was stopped goes on where it was."""

import csv
from collections.abc import Iterable, Sequence
from dataclasses import asdict, fields
from io import StringIO
from pathlib import Path
from typing import Any, Generic, TypeVar, get_type_hints
from zlib import crc32

from cloth_envs.files import reading, write_bytes
from cloth_envs.naming import unknown_name

Row = TypeVar("Row")
MARK = b"# crc32 "
REMEDY = "restore it, or remove it to measure again"


def read_names(text: str, known: Sequence[str], what: str) -> list[str]:
    """Names that a comma separates.

    Raises:
        ValueError: a name that is not ``known``, whose nearest match is told, or no name.
    """
    names = [name.strip() for name in text.split(",") if name.strip()]
    if not names:
        raise ValueError(f"{text!r} names no {what}: write some of {', '.join(known)}, or leave it out")
    for name in names:
        if name not in known:
            raise unknown_name(what, name, known)
    return names


def read_rows(path: Path, kind: type[Row]) -> list[Row]:
    """Dataclasses of str, int and float from the CSV that ``write_rows`` wrote; columns with a default may be missing.

    Raises:
        ValueError: the file is damaged, or has other columns.
    """
    types, needed = get_type_hints(kind), [name for name in get_type_hints(kind) if not hasattr(kind, name)]
    with reading(path, REMEDY):
        content = path.read_bytes().replace(b"\r\n", b"\n")
        body = content[: content.rfind(MARK)]
        whole = content == body + _mark(body, body.split(b"\n")[0].count(b",") + 1)
        text = (body if whole else content).decode()
        header, *lines = csv.reader(StringIO(text, newline=""), strict=True)
    if header != [name for name in types if name in header or name in needed]:
        raise ValueError(f"{path} has other columns than this version writes: remove it, or choose another --out")
    with reading(path, REMEDY):
        if not whole:
            raise ValueError("its last line is not its checksum")
        return [kind(**{n: types[n](text) for n, text in zip(header, line, strict=True)}) for line in lines]


def write_rows(path: Path, rows: Sequence[Any]) -> None:
    """Dataclasses as CSV, in place of what is there; the last line is a comment with the CRC-32 of those before.

    Raises:
        OSError: it can't be written; the old file stays.
    """
    names = [field.name for field in fields(rows[0])]
    text, table = StringIO(newline=""), [asdict(row) for row in rows]
    bare = any("\r" in str(value) for row in table for value in row.values())  # which csv leaves unquoted otherwise
    writer = csv.DictWriter(text, names, lineterminator="\n", quoting=csv.QUOTE_ALL if bare else csv.QUOTE_MINIMAL)
    writer.writeheader()
    writer.writerows(table)
    body = text.getvalue().encode()
    write_bytes(path, (body + _mark(body, len(names))).replace(b"\n", b"\r\n"))


def _mark(body: bytes, columns: int) -> bytes:
    """The last line: as many columns as the others have, so that tables of it are drawn."""
    return MARK + f"{crc32(body):08x}{',' * (columns - 1)}\n".encode()


def rounded(row: Row) -> Row:
    """``row`` with its floats to five digits: files stay small."""
    return type(row)(**{n: float(f"{v:.5g}") if isinstance(v, float) else v for n, v in vars(row).items()})


class Store(Generic[Row]):
    """Rows of one kind, known by the fields ``key``; written to ``path`` (if any) whenever one is added."""

    def __init__(self, path: Path | None, kind: type[Row], key: Iterable[str], *, fresh: bool = False) -> None:
        self.path, self.kind, self.key = path, kind, tuple(key)
        old = path is not None and path.is_file() and not fresh
        self.rows: list[Row] = read_rows(path, kind) if old and path else []
        self._known = {self._of(row) for row in self.rows}

    def _of(self, row: Row) -> tuple[Any, ...]:
        return tuple(getattr(row, name) for name in self.key)

    def __contains__(self, key: tuple[Any, ...]) -> bool:
        return key in self._known

    def add(self, *rows: Row) -> None:
        """Append ``rows``, each in place of one with the same key."""
        new = {self._of(row) for row in rows}
        kept = [old for old in self.rows if self._of(old) not in new] if new & self._known else self.rows
        self.replace([*kept, *rows])

    def replace(self, rows: Sequence[Row]) -> None:
        """Hold ``rows`` instead of what was held."""
        self.rows, self._known = list(rows), {self._of(row) for row in rows}
        if self.path is not None and rows:
            write_rows(self.path, self.rows)
