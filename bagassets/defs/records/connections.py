"""Connections to a database server.

With PostgreSQL each connection is a process of the server: so a few are kept, as Dagster's web server does, and each is
tried before it is used again, since the server may have been restarted. For SQLite see `sqlite_storage`.
"""

import sqlite3
from contextlib import closing
from functools import cache
from typing import Any

import dagster as dg
from sqlalchemy import event
from sqlalchemy.exc import DisconnectionError
from sqlalchemy.pool import Pool

from bagassets.defs.records.events import event_database

_NO_TIMEOUT = 0
_RECYCLE_S = 1800
_MORE_CONNECTIONS = 20  # for a moment, beside the one of each storage that is kept


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
