"""Cheaper use of databases that others write to, or serve.

With PostgreSQL each connection is a process of the server: so a few are kept, as Dagster's web server does, and each is
tried before it is used again, since the server may have been restarted. For SQLite see `sqlite_storage`.
"""

import sqlite3
from contextlib import closing
from functools import cache
from typing import Any, Self

import dagster as dg
from sqlalchemy import event
from sqlalchemy.exc import DisconnectionError
from sqlalchemy.pool import Pool

from bagassets.defs.records.events import event_database

_NO_TIMEOUT = 0
_RECYCLE_S = 1800
_MORE_CONNECTIONS = 20  # for a moment, beside the one of each storage that is kept


class Commits:
    """Tells in microseconds whether others may have committed to Dagster's databases, which takes milliseconds to read.

    SQLite counts the commits of other connections (https://sqlite.org/pragma.html#pragma_data_version). With other
    databases, and with one for each run, the answer is always yes. A context manager, for one thread.

    Args:
        instance: whose runs and events are in these databases.
    """

    def __init__(self, instance: dg.DagsterInstance) -> None:
        index = None if instance.event_log_storage.is_run_sharded else event_database(instance)
        self._files = [] if index is None else [index, index.parent.parent / "runs.db"]
        self._connections: list[sqlite3.Connection] = []
        self._seen: list[int] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._close()

    @property
    def can_tell(self) -> bool:
        """True where the answer may be no."""
        return bool(self._files)

    def any_since(self) -> bool:
        """Return whether there may have been any since the last call; yes at the first one in a block."""
        try:
            self._connections = self._connections or [
                sqlite3.connect(f"{file.resolve().as_uri()}?mode=rw", uri=True) for file in self._files
            ]
            versions = [
                connection.execute("PRAGMA data_version").fetchone()[0] for connection in self._connections
            ]
        except sqlite3.Error:  # busy, or being moved: reading them will say what is wrong
            self._close()
            return True
        before, self._seen = self._seen, versions
        return not versions or versions != before

    def _close(self) -> None:
        for connection in self._connections:
            connection.close()
        self._connections, self._seen = [], []  # the counts of two connections cannot be compared


def pool_connections(instance: dg.DagsterInstance) -> None:
    """Keep connections to the database server of an instance; one in SQLite is left as it is."""
    if event_database(instance) is None:
        _try_before_use()
        instance.optimize_for_webserver(_NO_TIMEOUT, _RECYCLE_S, _MORE_CONNECTIONS)


@cache
def _try_before_use() -> None:
    """Let all connections to PostgreSQL that this process takes from a pool be tried first."""
    event.listen(Pool, "checkout", _try)


def _try(connection: Any, _record: object, _proxy: object) -> None:
    if isinstance(connection, sqlite3.Connection):
        return
    try:
        with closing(connection.cursor()) as cursor:
            cursor.execute("SELECT 1")
    except Exception as err:  # of whatever driver: the pool opens another connection
        raise DisconnectionError from err
