"""JSON files of datasets: joining the rows of recordings without parsing them, and hashing files while writing."""

import json
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from bagassets.base.files import write
from bagassets.base.json_types import JsonMapping, JsonObject
from bagassets.store.canonical import digest_bytes

METRE_DIGITS = 6
SEPARATOR = b",\n"
"""What stands between two rows of a joined file."""
_BLOCK_BYTES = 1 << 20
_ROWS = "\0rows"


class Frame(NamedTuple):
    """What stands around the rows of a joined file.

    Attributes:
        head: before the first row.
        tail: after the last one.
        empty: the whole file if there are none.
    """

    head: bytes
    tail: bytes
    empty: bytes


TABLE = Frame(b"[\n", b"\n]\n", b"[]\n")


def write_hashed(path: Path, data: bytes) -> str:
    """Write a file and return its digest."""
    write(path, data)
    return digest_bytes(data)


def json_bytes(value: object) -> bytes:
    """Return a JSON file for people to read."""
    return (json.dumps(value, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()


def framed(value: JsonObject) -> Frame:
    """Return the frame of rows that are the list `bags` in a JSON file for people to read; they are made by `framed_row`."""
    head, tail = json_bytes({**value, "bags": [_ROWS]}).split(b"  " + json.dumps(_ROWS).encode())
    return Frame(head, tail, json_bytes({**value, "bags": []}))


def framed_row(value: JsonMapping) -> bytes:
    """Return a row of a list in a JSON file for people to read."""
    return b"  " + json_bytes(value).rstrip().replace(b"\n", b"\n  ")


def rounded(values: Iterable[float], digits: int = METRE_DIGITS) -> list[float]:
    """Return numbers rounded for writing, without negative zeros."""
    return [round(float(value), digits) + 0.0 for value in values]


def rows_bytes(rows: Sequence[bytes]) -> bytes:
    """Return a JSON list with one row per line."""
    return b"[\n" + b",\n".join(rows) + b"\n]\n" if rows else b"[]\n"


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


def column_texts(rows: Iterable[bytes], column: str) -> list[str]:
    """Return the texts of a column, in order, without parsing the rows; those without such a column have none.

    A dataset may have millions of rows. The texts must need no escapes, as tokens and file names do not.
    """
    return re.findall(f'"{column}":"([^"]*)"', b"\n".join(rows).decode())
