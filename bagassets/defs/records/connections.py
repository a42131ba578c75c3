"""Cheaper use of Dagster's databases by processes that write hundreds of events.

For every event Dagster opens a connection and closes it again.

With SQLite it also creates an engine. The last connection to close writes the write-ahead log back into the database
file, with two syncs of the disk, and a new engine compiles each statement again: so engines are reused here, and
connections kept open. To see whether a database has the newest schema, Alembic imports a hundred small modules: that happens
once, before workers are forked. And a commit does not wait for the disk: after a power loss the newest records may be
missing, which the next build records again from the store, but the database is whole.

With PostgreSQL each connection is a process of the server: so a few are kept, as Dagster's web server does, and each is
tried before it is used again, since the server may have been restarted.
"""

import sqlite3
from collections import Counter
from collections.abc import Iterator
from contextlib import closing, contextmanager
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, Self

import dagster as dg
from alembic.config import Config
from alembic.script import ScriptDirectory
from sqlalchemy import create_engine, event, make_url
from sqlalchemy.engine import Engine
from sqlalchemy.exc import DisconnectionError
from sqlalchemy.pool import NullPool, Pool, QueuePool

from bagassets.defs.dagster_private import get_alembic_config, sqlite_event_log, sqlite_run_storage
from bagassets.defs.records.events import event_database

__all__ = ["Commits", "kept_open", "pool_connections", "share_migrations"]

_FROM_CONFIG = "from_config"
_CREATE_ENGINE = "create_engine"  # the name under which both storages import it

_KEPT: Counter[str] = Counter()  # database file -> how many keep it open
_POOLED: dict[tuple[str, float | None], Engine] = {}  # database file, timeout -> engine with open connections
_DISPOSE = "dispose"  # called by Dagster after each event
_NO_TIMEOUT = 0
_RECYCLE_S = 1800
_MORE_CONNECTIONS = 20  # for a moment, beside the one of each storage that is kept


@cache
def share_migrations() -> None:
    """Let Alembic read Dagster's migrations now, and never again in this process and its children."""
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
    """Keep open the SQLite databases of an instance and of the events of some runs; other databases are left alone."""
    index = event_database(instance)
    if index is None:
        yield
        return
    _prepare_sqlite()
    files = [index, _runs_database(index), *(index.with_name(f"{run_id}.db") for run_id in run_ids)]
    paths = [str(path) for path in files]
    _KEPT.update(paths)
    try:
        yield
    finally:
        _KEPT.subtract(paths)
        for (path, _), engine in list(_POOLED.items()):
            if _KEPT[path] <= 0:
                Engine.dispose(engine)


class Commits:
    """Tells in microseconds whether others may have committed to Dagster's databases, which takes milliseconds to read.

    SQLite counts the commits of other connections (https://sqlite.org/pragma.html#pragma_data_version). With other
    databases, and with one for each run, the answer is always yes. A context manager, for one thread.

    Args:
        instance: whose runs and events are in these databases.
    """

    def __init__(self, instance: dg.DagsterInstance) -> None:
        index = None if instance.event_log_storage.is_run_sharded else event_database(instance)
        self._files = [] if index is None else [index, _runs_database(index)]
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


def _runs_database(index: Path) -> Path:
    return index.parent.parent / "runs.db"


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


@cache
def _prepare_sqlite() -> None:
    """Let all SQLite connections that this process opens from now on sync at checkpoints only, and Dagster reuse engines.

    It would create another one for the same file.
    """
    event.listen(Engine, "connect", _on_connect)
    for module in (sqlite_event_log, sqlite_run_storage):
        setattr(module, _CREATE_ENGINE, _create_engine)


def _create_engine(url: str, **options: Any) -> Engine:
    timeout_s = options.get("connect_args", {}).get("timeout")
    if options != _file_options(NullPool, timeout_s):
        return create_engine(url, **options)  # another version of Dagster: create what it asks for
    path = str(make_url(url).database)
    if _KEPT[path] <= 0:
        return _engine(url, timeout_s)
    if (path, timeout_s) not in _POOLED:
        engine = _small_engine(url, **_file_options(QueuePool, timeout_s))
        setattr(engine, _DISPOSE, lambda close=True: None)  # noqa: ARG005  (called as Engine.dispose is)
        _POOLED[path, timeout_s] = engine
    return _POOLED[path, timeout_s]


@lru_cache(maxsize=32)
def _engine(url: str, timeout_s: float | None) -> Engine:
    return _small_engine(url, **_file_options(NullPool, timeout_s))


def _small_engine(url: str, **options: Any) -> Engine:
    engine = create_engine(url, **options)
    event.listen(engine, "connect", _make_small)
    return engine


def _file_options(pool: type[Pool], timeout_s: float | None) -> dict[str, object]:
    return {"poolclass": pool} | ({} if timeout_s is None else {"connect_args": {"timeout": timeout_s}})


def _make_small(connection: Any, _record: object) -> None:
    """Let a database that is not there yet have small pages: that of a run has thirty tables and indexes, mostly empty."""
    connection.execute("PRAGMA page_size = 1024")


def _on_connect(connection: Any, _record: object) -> None:
    if isinstance(connection, sqlite3.Connection):
        connection.execute("PRAGMA synchronous = NORMAL")
