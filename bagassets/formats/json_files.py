"""JSON files of datasets: joining the rows of recordings without parsing them, and hashing files while writing."""

import json
import re
from collections.abc import Iterable, Iterator
from itertools import chain
from pathlib import Path
from typing import Protocol, Self

from blake3 import blake3

__all__ = [
    "HashedFile",
    "column_texts",
    "copy_rows",
    "json_bytes",
    "row_blocks",
    "rows_text",
    "write_hashed",
    "write_joined",
]

_BLOCK_BYTES = 1 << 20


class _Writable(Protocol):
    def write(self, data: bytes, /) -> object: ...


class HashedFile:
    """A file that is hashed while it is written."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("wb", buffering=1 << 20)
        self._hasher = blake3()

    def write(self, data: bytes) -> None:
        """Write bytes."""
        self._file.write(data)
        self._hasher.update(data)

    @property
    def digest(self) -> str:
        """Digest of what was written."""
        return self._hasher.hexdigest()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self._file.close()


def write_hashed(path: Path, data: bytes) -> str:
    """Write a file and return its digest."""
    with HashedFile(path) as file:
        file.write(data)
    return file.digest


def json_bytes(value: object) -> bytes:
    """Return a JSON file for people to read."""
    return (json.dumps(value, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()


def rows_text(path: Path | str) -> bytes:
    """Return the rows of a JSON list with one row per line, unchanged but without the brackets."""
    with open(path, "rb", buffering=0) as file:  # noqa: PTH123  (a path as text, of each of many small files)
        return file.read().removeprefix(b"[").removesuffix(b"]\n").strip(b"\n")


def row_blocks(path: Path) -> Iterator[list[bytes]]:
    """Yield the rows of a JSON list with one row per line, each as its JSON text, a megabyte of them at a time."""
    with path.open("rb") as file:
        while lines := file.readlines(_BLOCK_BYTES):
            # The brackets are at most two bytes, on lines of their own.
            yield [row for line in lines if len(row := line.strip(b" \t\r\n,")) > len(b"[]")]


def copy_rows(path: Path) -> Iterator[bytes]:
    """Yield the rows of a JSON list with one row per line, each as its JSON text."""
    return chain.from_iterable(row_blocks(path))


def column_texts(rows: Iterable[bytes], column: str) -> list[str]:
    """Return the texts of a column, in order, without parsing the rows; those without such a column have none.

    A dataset may have millions of rows. The texts must need no escapes, as tokens and file names do not.
    """
    return re.findall(f'"{column}":"([^"]*)"', b"\n".join(rows).decode())


def write_joined(file: _Writable, lists: Iterable[bytes]) -> int:
    """Join several lists, given as `rows_text`, into one; return the number of rows."""
    number = 0
    for text in lists:
        if text:
            file.write(b",\n" if number else b"[\n")
            file.write(text)
            number += text.count(b"\n") + 1
    file.write(b"\n]\n" if number else b"[]\n")
    return number
