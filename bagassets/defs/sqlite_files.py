"""Cheaper use of Dagster's SQLite files by processes that write hundreds of events.

Dagster opens a connection for every event and closes it again; the last one to close writes the log
(WAL) back into the database file, with two syncs of the disk. So somebody keeps one open meanwhile.
And a commit need not wait for the disk: after a power loss the newest records may be missing, which
the next build records again from the store, but the database is whole.
"""

import sqlite3
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

import dagster as dg
from sqlalchemy import event
from sqlalchemy.engine import Engine

from bagassets.defs.events import event_database

__all__ = ["kept_open"]


@contextmanager
def kept_open(instance: dg.DagsterInstance, *run_ids: str) -> Iterator[None]:
    """Keep the databases of an instance, and of some runs' events, open; nothing unless they are SQLite's."""
    index = event_database(instance)
    if index is None:
        yield
        return
    _relax_commits()
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


def _on_connect(connection: Any, _record: object) -> None:
    if isinstance(connection, sqlite3.Connection):
        connection.execute("PRAGMA synchronous = NORMAL")
