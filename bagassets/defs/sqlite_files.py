"""Cheaper use of Dagster's SQLite files by processes that write hundreds of events.

For every event Dagster makes an engine, opens a connection and closes it again. The last connection to
close writes the log (WAL) back into the database file, with two syncs of the disk: so somebody keeps
one open meanwhile. An engine compiles each statement anew: so the one of a file is used again. Whether
a database has the newest schema is asked of Alembic, which imports a hundred small modules for it: that is
done once, before workers are forked. And a commit need not wait for the disk: after a power loss the newest records may be missing, which the next
build records again from the store, but the database is whole.
"""

import sqlite3
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import dagster as dg
from alembic.config import Config
from alembic.script import ScriptDirectory
from dagster._core.storage.event_log.sqlite import sqlite_event_log
from dagster._core.storage.runs.sqlite import sqlite_run_storage
from dagster._core.storage.sql import get_alembic_config
from sqlalchemy import create_engine, event
from sqlalchemy.engine import Engine
from sqlalchemy.pool import NullPool

from bagassets.defs.events import event_database

__all__ = ["kept_open", "share_migrations"]

_FROM_CONFIG = "from_config"
_CREATE_ENGINE = "create_engine"  # what both storages call the function by


@cache
def share_migrations() -> None:
    """Have Alembic read Dagster's migrations now, and never again in this process and its children."""
    read = ScriptDirectory.from_config
    known: dict[str, ScriptDirectory] = {}

    def from_config(config: Config) -> ScriptDirectory:
        place = str(config.get_main_option("script_location"))
        if place not in known:
            known[place] = read(config)
        return known[place]

    setattr(ScriptDirectory, _FROM_CONFIG, staticmethod(from_config))
    from_config(get_alembic_config(str(sqlite_event_log.__file__))).get_heads()  # all storages share them


@contextmanager
def kept_open(instance: dg.DagsterInstance, *run_ids: str) -> Iterator[None]:
    """Keep the databases of an instance, and of some runs' events, open; nothing unless they are SQLite's."""
    index = event_database(instance)
    if index is None:
        yield
        return
    _relax_commits()
    _share_engines()
    files = [index, index.parent.parent / "runs.db", *(index.with_name(f"{run_id}.db") for run_id in run_ids)]
    with ExitStack() as stack:
        for path in files:
            _hold(path, stack)
        yield


def _hold(path: Path, stack: ExitStack) -> None:
    if not path.is_file():
        return
    with suppress(sqlite3.Error):  # Dagster will say what is wrong with it
        connection = stack.enter_context(closing(sqlite3.connect(path)))
        # Only a connection that has read holds the log.
        connection.execute("SELECT count(*) FROM sqlite_master").fetchone()


@cache
def _relax_commits() -> None:
    """Have every SQLite connection of this process from now on leave syncing to checkpoints."""
    event.listen(Engine, "connect", _on_connect)


@cache
def _share_engines() -> None:
    """Have Dagster use an engine again where it would make another one for the same file."""
    for module in (sqlite_event_log, sqlite_run_storage):
        setattr(module, _CREATE_ENGINE, _create_engine)


def _create_engine(url: str, **options: Any) -> Engine:
    timeout_s = options.get("connect_args", {}).get("timeout")
    if options != _file_options(timeout_s):
        return create_engine(url, **options)  # not as it was when this was written: as asked for
    return _engine(url, timeout_s)


@lru_cache(maxsize=32)
def _engine(url: str, timeout_s: float | None) -> Engine:
    return create_engine(url, **_file_options(timeout_s))


def _file_options(timeout_s: float | None) -> dict[str, Any]:
    return {"poolclass": NullPool} | ({} if timeout_s is None else {"connect_args": {"timeout": timeout_s}})


def _on_connect(connection: Any, _record: object) -> None:
    if isinstance(connection, sqlite3.Connection):
        connection.execute("PRAGMA synchronous = NORMAL")
