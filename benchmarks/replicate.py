"""Projects of 30,000 or 100,000 built recordings, in minutes: a small one is really built, then copied many times.

Of each copy, everything that commands look at is there, under names and digests of its own: the recording (a sparse file of
the size and time of the one that was built, which only differs in content), its digest on record, its partition, the runs and
events of Dagster, the actions, and the tables of its scenes, which are really made. Other artifacts are shared with the
recording that it is a copy of, so datasets hold hard links to the same files. `bagassets build` finds nothing to make but the
dataset, which `replicate` leaves to it.

What is not there: nothing in Dagster's text of an event says another storage id than that of the event that was copied.
"""

import os
import re
import sqlite3
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import AbstractContextManager, closing
from dataclasses import dataclass, replace
from functools import cache
from hashlib import sha256
from itertools import islice
from multiprocessing import get_context
from pathlib import Path
from typing import Any, TypeVar
from uuid import UUID, uuid5

import sqlalchemy as db

from bagassets.defs.builds.pending_work import open_project
from bagassets.defs.dagster_private import RunStorageSqlMetadata, SqlEventLogStorageMetadata
from bagassets.defs.records.partitions import add_partitions
from bagassets.engine.execute import execute
from bagassets.engine.graph import Graph
from bagassets.formats.catalogue import formats, recording_assets
from bagassets.recipe import load_recipe
from bagassets.recordings.digest import recording_digest, recording_stat
from bagassets.recordings.digest_record import DigestIndex
from bagassets.recordings.discover import discover
from bagassets.recordings.model import RecordingFiles
from bagassets.store.canonical import digest_file
from bagassets.store.store import Outcome

__all__ = ["add_unbuilt", "replicate"]

T = TypeVar("T")

# What differs between a recording and its copy: digests, ids of runs, and keys, which are file names.
_NAMES = re.compile(r"[0-9a-f]{64}|[0-9a-f]{8}(?:-[0-9a-f]{4}){3}-[0-9a-f]{12}|r[0-9]{5}\.bag")
_HEAD = 64  # bytes of a copied recording that are no hole: so much is taken from the original
_ROWS = 5000  # written at a time
_EVENT_IDS = ("event_id", "evaluation_event_storage_id", "materialization_event_storage_id")
_AT_A_TIME = 25  # copies that a worker makes at a time


@dataclass(frozen=True)
class _Copy:
    """A copy of a recording that was built.

    Attributes:
        original: its partition key.
        key: that of the copy.
    """

    original: str
    key: str


def replicate(recipe_file: Path, copies: int) -> int:
    """Copy each built recording of a project so often; return how many recordings there are then.

    Args:
        recipe_file: of a project that was built, and has recordings `r00000.bag` and so on.
        copies: of each recording.
    """
    recipe = load_recipe(recipe_file)
    originals = discover(recipe.bags).recordings
    number = len(originals)
    made = [
        _Copy(key, f"r{number * copy + index:07}.bag")
        for copy in range(1, copies + 1)
        for index, key in enumerate(originals)
    ]
    changed: dict[str, dict[str, str]] = {}
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as pool:
        parts = [(recipe_file, part) for part in _batches(made, _AT_A_TIME)]
        for part in pool.map(_make_parts, parts):
            changed |= part
    with open_project(recipe_file) as workspace:
        instance = workspace.instance
        _index(recipe.state, [recipe.bags.root / copy.key for copy in made], changed)
        tables = _tables(instance)
        for copy in range(1, copies + 1):
            texts: dict[str, str] = {}
            for one in made[number * (copy - 1) : number * copy]:
                texts |= {one.original: one.key, **changed[one.key]}
            _copy_records(tables, texts, copy)
        add_partitions(workspace.records, [one.key for one in made])
        _go_on_counting(tables.values())
    return number * (copies + 1)


def add_unbuilt(recipe_file: Path, number: int) -> None:
    """Register recordings that are not built: sparse files, of which nobody reads more than sizes."""
    bags = load_recipe(recipe_file).bags
    original = next(iter(discover(bags).recordings.values()))
    keys = [f"u{index:07}.bag" for index in range(number)]
    for key in keys:
        _copy_file(original.path, bags.root / key)
    with open_project(recipe_file) as workspace:
        add_partitions(workspace.records, keys)


# --- recordings and artifacts ------------------------------------------------------------


def _make_parts(asked: tuple[Path, Sequence[_Copy]]) -> dict[str, dict[str, str]]:
    """Make what lies in the store of some copies; return key -> text in the original's records -> text in its own."""
    recipe_file, copies = asked
    _, found = _project(recipe_file)
    return {copy.key: _make_one(recipe_file, found[copy.original], copy.key) for copy in copies}


def _make_one(recipe_file: Path, original: RecordingFiles, key: str) -> dict[str, str]:
    recipe, _ = _project(recipe_file)
    path = recipe.bags.root / key
    _copy_file(original.path, path)
    recording = replace(original, key=key, relative=key, path=path, files=(path,))
    assets = recording_assets(recipe)
    graphs = []
    for one in (original, recording):
        digest = (
            recording_digest(one, DigestIndex.of(recipe)).digest if one is original else digest_file(path)
        )
        graphs.append(Graph(assets, one, digest, recording_stat(one)))
    before, now = graphs
    made_anew = {kind.part for kind in formats()}
    shared = {node.name: node.artifact for node in before.nodes() if node.asset not in made_anew}
    for node in now.nodes():
        if node.is_open and (artifact := shared.get(node.name)) is not None:
            assets.store.record(node.known_action, artifact, 0.01)
            now.settle(node, Outcome(artifact, node.known_action.digest, cached=True, seconds=0.01))
    list(execute(now))
    texts = {str(before.digest): str(now.digest)}
    for was, new in zip(before.nodes(), now.nodes(), strict=True):
        texts[was.known_action.digest] = new.known_action.digest
        texts[str(was.data_version)] = str(new.data_version)
    # Dagster notes digests of the versions of what was read.
    return texts | {_read(was): _read(new) for was, new in texts.items()}


@cache
def _project(recipe_file: Path) -> tuple[Any, Mapping[str, RecordingFiles]]:
    recipe = load_recipe(recipe_file)
    return recipe, discover(recipe.bags).recordings


def _copy_file(original: Path, path: Path) -> None:
    """Write a file of the same size, time and beginning, with its own name behind that, and nothing else."""
    status = original.stat()
    with original.open("rb") as file:
        head = file.read(_HEAD)
    with path.open("wb") as file:
        file.write(head + path.name.encode())
        file.truncate(status.st_size)
    os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns))


def _read(version: str) -> str:
    return sha256(version.encode()).hexdigest()


def _index(state: Path, paths: Iterable[Path], changed: Mapping[str, Mapping[str, str]]) -> None:
    """Put the digests of the copies on record."""
    rows = []
    for path in paths:
        status, digest = path.stat(), next(iter(changed[path.name].values()))
        rows.append(
            (str(path), status.st_size, status.st_mtime_ns, status.st_ino, status.st_ctime_ns, digest)
        )
    with closing(sqlite3.connect(state / "digests.sqlite")) as connection, connection:
        connection.executemany("INSERT OR REPLACE INTO digests VALUES (?, ?, ?, ?, ?, ?)", rows)


# --- Dagster's records -------------------------------------------------------------------


@dataclass(frozen=True)
class _Table:
    """A table of Dagster.

    Attributes:
        connect: opens its database.
        table: its definition.
        rows: those about recordings that were really built.
        last_id: the largest id in it.
    """

    connect: Callable[[], AbstractContextManager[Any]]
    table: Any
    rows: list[dict[str, Any]]
    last_id: int


def _copy_records(tables: Mapping[str, _Table], texts: Mapping[str, str], number: int) -> None:
    """Copy the runs, events and checks of all recordings that were built.

    Args:
        tables: see `_tables`.
        texts: text in the records -> text in the copy.
        number: of the copy.
    """
    runs = [row["run_id"] for row in tables["runs"].rows]
    new = {**texts, **{run_id: str(uuid5(UUID(run_id), str(number))) for run_id in runs}}
    events = tables["event_logs"].last_id * number

    def copied(one: _Table) -> Iterator[dict[str, Any]]:
        for row in one.rows:
            values = {column: _renamed(value, new) for column, value in row.items()}
            values["id"] += one.last_id * number
            yield values | {name: row[name] + events for name in _EVENT_IDS if row.get(name) is not None}

    for one in tables.values():
        with one.connect() as connection:
            for some in _batches(copied(one), _ROWS):
                connection.execute(one.table.insert(), some)


def _renamed(value: Any, texts: Mapping[str, str]) -> Any:
    return _NAMES.sub(lambda found: texts.get(found[0], found[0]), value) if type(value) is str else value


def _tables(instance: Any) -> dict[str, _Table]:
    """Return name -> table, for each table with rows about recordings, in the order of writing."""
    events, runs = instance.event_log_storage, instance.run_storage
    found = {name: _table(runs.connect, RunStorageSqlMetadata.tables[name]) for name in ("runs", "run_tags")}
    for name in ("event_logs", "asset_event_tags", "asset_check_executions"):
        found[name] = _table(events.index_connection, SqlEventLogStorageMetadata.tables[name])
    # Not the runs of datasets.
    ours = {row["run_id"] for row in found["runs"].rows if _NAMES.search(row["partition"] or row["run_body"])}
    logged = {row["id"] for row in found["event_logs"].rows if row["run_id"] in ours}
    return {
        name: replace(
            one, rows=[row for row in one.rows if row.get("run_id") in ours or row.get("event_id") in logged]
        )
        for name, one in found.items()
    }


def _table(connect: Callable[[], AbstractContextManager[Any]], table: Any) -> _Table:
    with connect() as connection:
        rows = [dict(row) for row in connection.execute(db.select(table)).mappings()]
    return _Table(connect, table, rows, max((row["id"] for row in rows), default=0))


def _go_on_counting(tables: Iterable[_Table]) -> None:
    """Let PostgreSQL count on behind the ids that were written; SQLite does so by itself."""
    for one in tables:
        with one.connect() as connection:
            if connection.dialect.name == "postgresql":
                name = one.table.name
                query = f"SELECT setval(pg_get_serial_sequence('{name}', 'id'), max(id)) FROM {name}"
                connection.execute(db.text(query))


def _batches(rows: Iterable[T], size: int) -> Iterator[list[T]]:
    left = iter(rows)
    while some := list(islice(left, size)):
        yield some
