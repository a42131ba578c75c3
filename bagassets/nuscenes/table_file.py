"""Tables as files: a JSON list with one row per line.

The form is canonical: columns in the order of the schema, no spaces, shortest floats. Tables of
recordings are joined by copying lines, without parsing them.

Numbers are rounded before they are written: metres and pixels to a millionth, quaternions to nine
digits. That is finer than any sensor, keeps the files small, and hides differences in the last bit
between processors, should an operation ever have any.
"""

import json
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Protocol

from bagassets.errors import DatasetError
from bagassets.nuscenes.schema import TABLES, Row

__all__ = [
    "copy_rows",
    "json_bytes",
    "quaternion",
    "read_table",
    "rounded",
    "rows_text",
    "table_bytes",
    "write_joined",
]


class _Writable(Protocol):
    def write(self, data: bytes, /) -> object: ...


METRE_DIGITS = 6
QUATERNION_DIGITS = 9


def rounded(values: Iterable[float], digits: int = METRE_DIGITS) -> list[float]:
    """Return numbers rounded for writing; there is no negative zero."""
    return [round(float(value), digits) + 0.0 for value in values]


def quaternion(values: Iterable[float]) -> list[float]:
    """Return a unit quaternion w, x, y, z rounded for writing."""
    return rounded(values, QUATERNION_DIGITS)


def table_bytes(name: str, rows: Sequence[Row]) -> bytes:
    """Return the file of a table.

    Raises:
        KeyError: a row lacks a column of the schema.
    """
    columns = TABLES[name].columns
    lines = [_line({column: row[column] for column in columns}) for row in rows]
    return _joined(lines)


def json_bytes(value: Any) -> bytes:
    """Return the file of anything but a table, for people to read."""
    return (json.dumps(value, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()


def read_table(folder: Path, name: str) -> list[dict[str, Any]]:
    """Return the rows of a table of a folder.

    Raises:
        DatasetError: the file is missing or is no table.
    """
    path = folder / f"{name}.json"
    try:
        rows = json.loads(path.read_bytes())
    except (OSError, ValueError) as err:
        raise DatasetError(
            f"{path}: this nuScenes table cannot be read ({err}); build the dataset again."
        ) from err
    if not isinstance(rows, list):
        raise DatasetError(f"{path}: a nuScenes table must be a list of rows; build the dataset again.")
    return rows


def rows_text(path: Path) -> bytes:
    """Return the rows of a file made by `table_bytes` as they stand there, without the brackets."""
    return path.read_bytes().removeprefix(b"[").removesuffix(b"]\n").strip(b"\n")


def copy_rows(path: Path) -> Iterator[bytes]:
    """Yield the rows of a file made by `table_bytes`, each as its JSON text."""
    with path.open("rb") as file:
        for line in file:
            text = line.strip().rstrip(b",")
            if text not in (b"[", b"]", b"[]"):
                yield text


def write_joined(file: _Writable, tables: Iterable[bytes]) -> int:
    """Write one table of the rows of several, given as `rows_text`; return the number of rows."""
    number = 0
    for text in tables:
        if text:
            file.write(b",\n" if number else b"[\n")
            file.write(text)
            number += text.count(b"\n") + 1
    file.write(b"\n]\n" if number else b"[]\n")
    return number


def _line(row: Row) -> bytes:
    return json.dumps(row, separators=(",", ":"), ensure_ascii=False, allow_nan=False).encode()


def _joined(lines: Sequence[bytes]) -> bytes:
    return b"[\n" + b",\n".join(lines) + b"\n]\n" if lines else b"[]\n"
