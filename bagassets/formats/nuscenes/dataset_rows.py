"""The rows of a finished dataset: all of them or, where they would fill the memory, those of some recordings."""

import json
import os
from binascii import unhexlify
from collections.abc import Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property, partial
from itertools import chain
from pathlib import Path
from stat import S_ISREG

import numpy as np

from bagassets.base.json_types import JsonObject
from bagassets.formats.dataset_lock import read_lock
from bagassets.formats.json_files import column_texts, row_blocks
from bagassets.formats.nuscenes.schema import RECORDING_TABLES, SHARED_TABLES, TABLES, Row
from bagassets.formats.nuscenes.subset import rows_of_scenes
from bagassets.formats.nuscenes.table_file import errors_explained, read_table

# Rows take about eight times as much memory as disk space.
MOST_BYTES = 128 * 1024 * 1024
# A row begins with {"token":"; this many hex digits tell 10^8 tokens apart.
_START, _DIGITS = len(b'{"token":"'), 16
_PARSED_ROWS = 10_000


@dataclass(frozen=True)
class DatasetRows:
    """The tables of a dataset.

    Attributes:
        dataroot: folder of samples, sweeps and maps.
        version: name of the version folder.
        tables: table -> rows; for recordings that were not chosen, only the rows of `log`.
        scenes: names of all scenes.
        recordings: number of recordings whose rows are in `tables`.
        of: number of recordings in the dataset.
        rigs: recording -> its rig, according to the lock file.
    """

    dataroot: Path
    version: str
    tables: Mapping[str, Sequence[Row]]
    scenes: AbstractSet[str]
    recordings: int
    of: int
    rigs: Mapping[str, str] = field(default_factory=dict)

    @property
    def is_whole(self) -> bool:
        """Tell whether the rows of all recordings are there."""
        return self.recordings == self.of

    @property
    def folder(self) -> Path:
        """The version folder."""
        return self.dataroot / self.version

    @cached_property
    def sizes(self) -> Mapping[str, int]:
        """Path below the dataroot -> size in bytes, of all files there, or of those in `sample_data` if that is not whole."""
        if self.is_whole:
            return file_sizes(self.dataroot)
        sizes = {}
        for row in self.tables["sample_data"]:
            name = str(row["filename"])
            with suppress(OSError):
                sizes[name] = os.stat(f"{self.dataroot}/{name}").st_size
        return sizes


def file_sizes(dataroot: Path) -> dict[str, int]:
    """Return path below the dataroot -> size in bytes, of the files in `samples`, `sweeps` and `maps`.

    A dataset may have a million files: each is looked at once, and pathlib, which takes ten times as long, is not used.
    """
    sizes: dict[str, int] = {}
    folders = ["samples", "sweeps", "maps"]
    while folders:
        below = folders.pop()
        with suppress(OSError), os.scandir(f"{dataroot}/{below}") as entries:
            for entry in entries:
                if entry.is_dir(follow_symlinks=False):
                    folders.append(f"{below}/{entry.name}")
                    continue
                with suppress(OSError):  # a link to nothing
                    status = entry.stat()
                    if S_ISREG(status.st_mode):
                        sizes[f"{below}/{entry.name}"] = status.st_size
    return sizes


def number_of_files(dataroot: Path) -> int:
    """Return the number of files, none of which is looked at, in `samples`, `sweeps` and `maps`, and in their folders.

    A folder in one of these counts as one.
    """
    number = 0
    for name in ("samples", "sweeps", "maps"):
        with suppress(FileNotFoundError), os.scandir(f"{dataroot}/{name}") as entries:
            for entry in entries:
                number += len(os.listdir(entry.path)) if entry.is_dir() else 1  # noqa: PTH208  (half a million names)
    return number


def read_dataset(
    dataroot: Path, version: str, most_bytes: int = MOST_BYTES, doubted: AbstractSet[str] = frozenset()
) -> DatasetRows:
    """Read the tables of a dataset written by bagassets.

    Args:
        dataroot: folder of samples, sweeps and maps.
        version: name of the version folder.
        most_bytes: of larger tables, the rows of evenly spaced recordings are read, as many as fit.
        doubted: tokens of logs of recordings that are read instead of these, if there are any.

    Raises:
        DatasetError: a table is missing or cannot be read.
    """
    folder = dataroot / version
    logs, scenes = read_table(folder, "log"), read_table(folder, "scene")
    names = frozenset(str(row["name"]) for row in scenes)
    lock = read_lock(folder)
    rigs = {} if lock is None else {key: str(bag.row["rig"]) for key, bag in lock.bags.items()}
    paths = [folder / f"{name}.json" for name in TABLES]
    size = sum(path.stat().st_size for path in paths if path.is_file())
    if size <= most_bytes:
        tables = {name: read_table(folder, name) for name in TABLES}
        return DatasetRows(dataroot, version, tables, names, len(logs), len(logs), rigs)
    step = max(1, -(-size // most_bytes))
    candidates = [row for row in logs if row["token"] in doubted] or logs[::step]
    chosen = {str(row["token"]) for row in candidates[: -(-len(logs) // step)]}
    rows = {name: read_table(folder, name) for name in SHARED_TABLES}
    kept = [row for row in scenes if row["log_token"] in chosen]
    rows |= {"log": logs, **rows_of_scenes(kept, partial(_chosen, folder))}
    return DatasetRows(
        dataroot, version, {name: rows[name] for name in TABLES}, names, len(chosen), len(logs), rigs
    )


def repeated_tokens(folder: Path) -> Iterator[tuple[str, list[str]]]:
    """Yield each table of recordings with repeated tokens, and these in order of appearance.

    Only eight bytes per row are kept in memory.

    Raises:
        DatasetError: a table cannot be read.
    """
    for table in RECORDING_TABLES:
        path = folder / f"{table}.json"
        starts = bytearray()
        with errors_explained(path):
            for rows in row_blocks(path):
                starts += unhexlify(b"".join([row[_START : _START + _DIGITS] for row in rows]))
        ordered = np.sort(np.frombuffer(starts, dtype=">u8").astype(np.uint64))
        suspects = set(ordered[1:][ordered[1:] == ordered[:-1]].tolist())
        seen: set[str] = set()
        repeated: dict[str, None] = {}
        for text in chain.from_iterable(row_blocks(path)) if suspects else ():
            if int(text[_START : _START + _DIGITS], 16) in suspects:
                (token,) = _values([text], "token")
                if token in seen:
                    repeated[token] = None
                seen.add(token)
        if repeated:
            yield table, list(repeated)


def _chosen(folder: Path, table: str, column: str, wanted: AbstractSet[str]) -> list[JsonObject]:
    path = folder / f"{table}.json"
    with errors_explained(path):
        texts = [
            text
            for rows in row_blocks(path)
            for text, value in zip(rows, _values(rows, column), strict=True)
            if value in wanted
        ]
        # Rows that are parsed together share the names of their columns, and take a third of the time.
        return [
            row
            for start in range(0, len(texts), _PARSED_ROWS)
            for row in json.loads(b"[%b]" % b",".join(texts[start : start + _PARSED_ROWS]))
        ]


def _values(rows: Sequence[bytes], column: str) -> list[str]:
    """Return the text of a column in each row, without parsing the rows.

    Raises:
        ValueError: a row has no such column, or more than one.
    """
    values = column_texts(rows, column)
    if len(values) != len(rows):
        raise ValueError(f"a row has no {column}, or more than one")
    return values
