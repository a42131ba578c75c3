"""The folder of tables of a dataset: rows of recordings joined, shared rows made once, splits, lock."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Self

from blake3 import blake3

from bagassets.nuscenes import shared_rows
from bagassets.nuscenes.schema import RECORDING_TABLES, TABLES
from bagassets.nuscenes.splits import devkit_split_name
from bagassets.nuscenes.table_file import json_bytes, rows_text, table_bytes, write_joined
from bagassets.recipe.model import NuScenes
from bagassets.recipe.model_splits import Splits
from bagassets.splits import SplitShare, shares_of
from bagassets.store.artifact import Artifact

__all__ = ["LOCK", "SPLITS", "BagPart", "Entry", "WrittenTables", "write_tables"]

LOCK = "dataset.lock.json"
SPLITS = "splits.json"


@dataclass(frozen=True)
class BagPart:
    """A recording that may enter a dataset.

    Attributes:
        key: partition key.
        content: digest of the recording's content; equal content enters once.
        tables: digest of its `nuscenes_tables` artifact.
    """

    key: str
    content: str
    tables: str


@dataclass(frozen=True)
class Entry:
    """A recording that does enter."""

    part: BagPart
    artifact: Artifact

    @cached_property
    def facts(self) -> dict[str, Any]:
        """What the recording's tables say about themselves."""
        facts: dict[str, Any] = self.artifact.read_json("facts.json")
        return facts

    def rows(self, table: str) -> bytes:
        """Return the rows of a table as JSON text."""
        return rows_text(self.artifact.path(f"{table}.json"))

    def files(self) -> list[dict[str, str]]:
        """Return `filename`, `artifact` and `file` of each file that the tables name."""
        files: list[dict[str, str]] = self.artifact.read_json("files.json")
        return files


@dataclass(frozen=True)
class WrittenTables:
    """What `write_tables` wrote.

    Attributes:
        rows: table -> number of rows.
        digests: file -> digest of its content.
        splits: name in splits.json -> its scenes.
        split_of: partition key -> split of the recipe.
        shares: what each split got, against what the recipe asks for.
    """

    rows: dict[str, int]
    digests: dict[str, str]
    splits: dict[str, list[str]]
    split_of: dict[str, str]
    shares: list[SplitShare]


def write_tables(
    folder: Path,
    entries: Sequence[Entry],
    settings: NuScenes,
    recipe_splits: Splits,
    dealt: Mapping[str, str],
) -> WrittenTables:
    """Write all 13 tables and `splits.json` into a folder that exists.

    Memory does not grow with the number of recordings, but for their scenes and logs.

    Args:
        folder: empty folder.
        entries: recordings in the order of their keys.
        settings: the recipe's `nuscenes`.
        recipe_splits: the recipe's `splits`.
        dealt: recording -> its split.
    """
    rows: dict[str, int] = {}
    digests: dict[str, str] = {}
    for table in RECORDING_TABLES:
        with _HashedFile(folder / f"{table}.json") as file:
            rows[table] = write_joined(file, (entry.rows(table) for entry in entries))
            digests[f"{table}.json"] = file.digest
    for table, shared in _shared(entries, settings).items():
        rows[table] = len(shared)
        digests[f"{table}.json"] = _write(folder / f"{table}.json", table_bytes(table, shared))
    split_by_key = {entry.part.key: dealt[entry.part.key] for entry in entries}
    splits: dict[str, list[str]] = {devkit_split_name(name): [] for name in sorted(recipe_splits.shares)}
    for entry in entries:
        names = [row["name"] for row in entry.artifact.read_json("scene.json")]
        splits[devkit_split_name(split_by_key[entry.part.key])] += names
    digests[SPLITS] = _write(folder / SPLITS, json_bytes(splits))
    ordered = {name: rows[name] for name in TABLES}
    durations_s = [(entry.part.key, entry.facts["counts"]["duration_s"]) for entry in entries]
    shares = shares_of(durations_s, recipe_splits, dealt)
    return WrittenTables(ordered, dict(sorted(digests.items())), splits, split_by_key, shares)


def _shared(entries: Sequence[Entry], settings: NuScenes) -> Mapping[str, list[dict[str, Any]]]:
    facts = [entry.facts for entry in entries]
    sensors = {pair for fact in facts for pair in fact["channels"].items()}
    logs = [row["token"] for entry in entries for row in entry.artifact.read_json("log.json")]
    return {
        "category": shared_rows.category_rows(settings.categories, _met(facts, "categories")),
        "attribute": shared_rows.attribute_rows(settings.attributes, _met(facts, "attributes")),
        "visibility": shared_rows.visibility_rows(),
        "sensor": shared_rows.sensor_rows(sensors),
        "map": shared_rows.map_rows(logs),
    }


def _met(facts: Iterable[Mapping[str, Any]], what: str) -> set[str]:
    return {name for fact in facts for name in fact[what]}


def _write(path: Path, data: bytes) -> str:
    with _HashedFile(path) as file:
        file.write(data)
    return file.digest


class _HashedFile:
    """A file that is written and digested in one go."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("wb", buffering=1 << 20)
        self._hasher = blake3()

    def write(self, data: bytes) -> None:
        self._file.write(data)
        self._hasher.update(data)

    @property
    def digest(self) -> str:
        return self._hasher.hexdigest()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self._file.close()
