"""Table files: a JSON list with one row per line.

The form is canonical: columns in the order of the schema, no spaces, shortest exact floats. Tables of recordings are
joined by copying lines, without parsing them.

Numbers are rounded before they are written: metres and pixels to six decimals, quaternions to nine. That is finer than any
sensor, keeps files small, and hides differences in the last bit between processors, should there ever be any.
"""

import json
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from bagassets.base.errors import DatasetError
from bagassets.base.json_types import JsonObject
from bagassets.formats.json_files import rounded, rows_bytes
from bagassets.formats.nuscenes.schema import TABLES, Row

QUATERNION_DIGITS = 9
# `json.dumps` makes one for each call that has options.
_LINE = json.JSONEncoder(separators=(",", ":"), ensure_ascii=False, allow_nan=False)


def quaternion(values: Iterable[float]) -> list[float]:
    """Return a unit quaternion w, x, y, z rounded for writing."""
    return rounded(values, QUATERNION_DIGITS)


def table_bytes(name: str, rows: Sequence[Row]) -> bytes:
    """Return the file of a table.

    Raises:
        KeyError: a row lacks a column of the schema.
    """
    columns = TABLES[name].columns
    return rows_bytes([_LINE.encode({column: row[column] for column in columns}).encode() for row in rows])


def read_table(folder: Path, name: str) -> list[JsonObject]:
    """Return the rows of a table of a folder.

    Raises:
        DatasetError: the file is missing or not a table.
    """
    path = folder / f"{name}.json"
    with errors_explained(path):
        rows = json.loads(path.read_bytes())
    if not isinstance(rows, list):
        raise DatasetError(f"{path}: a nuScenes table must be a list of rows; build the dataset again.")
    return rows


@contextmanager
def errors_explained(path: Path) -> Iterator[None]:
    """Turn errors of a file or its content into ours.

    Raises:
        DatasetError: the block raised OSError or ValueError.
    """
    try:
        yield
    except (OSError, ValueError) as err:
        raise DatasetError(
            f"{path}: this nuScenes table cannot be read ({err}); build the dataset again."
        ) from err
