"""Dagster's records in SQLite with the events of all runs in one database, and with connections that stay open.

Dagster gives each run a database of its own, and copies into a common one what it says of assets: empty tables and
indexes for every run, and each materialization and check twice. Here new runs write to the common one alone, as they do in
PostgreSQL. Runs that have a database of their own keep it, so a project of before needs no conversion: it changes over
when its `dagster.yaml` names this storage.

For every event Dagster also makes an engine, which compiles each statement again, opens a connection and closes it: the last
connection to close writes the write-ahead log back into the database file, with two syncs of the disk. Whenever an instance
is opened, Alembic imports a hundred small modules, to see whether a database is new. Here engines are reused, a connection
to each file stays open until the instance is disposed of, and `databases` sees to it that they are whole. A commit does
not wait for the disk: after a power loss the newest records may be missing, which the next build records again from the
store, but the database is whole.
"""

import os
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from datetime import UTC, datetime
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, Self

import dagster as dg
from sqlalchemy import Connection, Engine, QueuePool, bindparam, create_engine, event, update
from sqlalchemy.exc import DisconnectionError

from bagassets.defs.dagster_private import (
    ASSET_EVENTS,
    AssetKeyTable,
    ConfigurableClassData,
    DagsterSqliteStorage,
    SqlEventLogStorage,
    SqlEventLogStorageTable,
    SqliteEventLogStorage,
    SqliteRunStorage,
    SqliteScheduleStorage,
    SqlPollingEventWatcher,
)
from bagassets.defs.records.databases import EVENTS, RUNS, SCHEDULES, make_whole

# Statements made once: SQLAlchemy takes longer to make one than SQLite to execute it.
_INSERT_EVENT = SqlEventLogStorageTable.insert()
_NOTE_LATEST = update(AssetKeyTable).where(AssetKeyTable.c.asset_key == bindparam("its_key"))
_COMMON = "index"
_BUSY_S = 30.0  # as Dagster has it for events


@lru_cache(maxsize=32)
def _engine(url: str) -> Engine:
    """Return the engine of a database file, which keeps a few connections as long as it is the same file."""
    engine = create_engine(url, poolclass=QueuePool, max_overflow=-1, connect_args={"timeout": _BUSY_S})
    path = str(engine.url.database)

    def opened(connection: Any, record: Any) -> None:
        connection.execute("PRAGMA synchronous = NORMAL")
        record.info["file"] = _identity(path)

    def taken(_connection: Any, record: Any, _proxy: object) -> None:
        # The state folder was removed, say, and there is another one.
        if record.info["file"] != _identity(path):
            raise DisconnectionError

    event.listen(engine, "connect", opened)
    event.listen(engine, "checkout", taken)
    return engine


def _transaction(url: str) -> AbstractContextManager[Connection]:
    return _engine(url).begin()


def _identity(path: str) -> tuple[int, int] | None:
    with suppress(OSError):
        found = os.stat(path)
        return found.st_dev, found.st_ino
    return None


class _KeptOpen:
    """A storage of Dagster's whose connection to its file stays open."""

    _conn_string: str

    @contextmanager
    def connect(self) -> Iterator[Connection]:
        """Yield a transaction."""
        with _transaction(self._conn_string) as connection:
            yield connection

    def dispose(self) -> None:
        """Close what is open."""
        _engine(self._conn_string).dispose()


class _RunStorage(_KeptOpen, SqliteRunStorage):
    pass


class _ScheduleStorage(_KeptOpen, SqliteScheduleStorage):
    pass


class _EventLogStorage(SqliteEventLogStorage):
    """The events of each run in a file of its own, as Dagster has them, but with files that stay open."""

    def has_table(self, table_name: str) -> bool:
        """Return whether there is a table: Dagster asks for some of them with each event of an asset, and none goes."""
        if table_name not in self._there:
            with self.index_connection() as connection:
                if connection.dialect.has_table(connection, table_name):
                    self._there.add(table_name)
        return table_name in self._there

    def _store_asset_event(
        self, conn: Connection, event: dg.EventLogEntry, event_id: int, text: str | None = None
    ) -> None:
        """Note the latest event of an asset; Dagster inserts, and updates once that has failed, as it nearly always does.

        With `text`, the event as it was recorded, a materialization need not be spelled out once more.
        """
        happened = event.get_dagster_event()
        if text is not None and happened.is_step_materialization:
            record = f'{{"__class__": "EventLogRecord", "event_log_entry": {text}, "storage_id": {event_id}}}'
            values: dict[str, Any] = {"last_materialization": record, "last_run_id": event.run_id}
            values["last_materialization_timestamp"] = datetime.fromtimestamp(event.timestamp, UTC)
        else:
            values = self._get_asset_entry_values(event, event_id, True)
        if happened.asset_key is None or not values:
            return
        if not conn.execute(_NOTE_LATEST, {"its_key": happened.asset_key.to_string(), **values}).rowcount:
            super()._store_asset_event(conn, event, event_id)

    @cached_property
    def _there(self) -> set[str]:
        return set()

    def dispose(self) -> None:
        """Close what is open."""
        super().dispose()
        for shard in list(self._initialized_dbs):
            _engine(self.conn_string_for_shard(shard)).dispose()

    @contextmanager
    def _connect(self, shard: str) -> Iterator[Connection]:
        """Yield a transaction in the file of a run, or of all."""
        if shard != _COMMON and not Path(self.path_for_shard(shard)).exists():
            with super()._connect(shard):  # makes it
                pass
        self._initialized_dbs.add(shard)
        with _transaction(self.conn_string_for_shard(shard)) as connection:
            yield connection


class ProjectEventLogStorage(_EventLogStorage):
    """The events of all runs in one SQLite file, but for runs that have a file of their own."""

    def run_connection(self, run_id: str | None = None) -> Any:
        """Return a connection to the events of a run."""
        return self._connect(run_id if run_id is not None and self._has_own(run_id) else _COMMON)

    def store_event(self, event: dg.EventLogEntry) -> None:
        """Record an event once; that of an asset in one transaction with what finds it."""
        self._thread.event_id = None
        if self._has_own(event.run_id):
            super().store_event(event)  # a run that was begun before the change
        elif event.dagster_event is None or event.dagster_event.event_type not in ASSET_EVENTS:
            SqlEventLogStorage.store_event(self, event)
        else:
            with self._connect(_COMMON) as connection:
                row = self._event_to_row(event)
                event_id = connection.execute(_INSERT_EVENT, row).inserted_primary_key[0]  # type: ignore[index]  # of an insert never None
                if event.dagster_event.asset_key is not None:
                    self._store_asset_event(connection, event, event_id, row["event"])
                    self._store_asset_event_tags(connection, [event], [event_id])
            self._thread.event_id = event_id

    @property
    def last_asset_event_id(self) -> int | None:
        """The id of the event of an asset that this thread has just recorded; None if it was another event, or is in a file of its run."""
        return getattr(self._thread, "event_id", None)

    def get_event_records(
        self, event_records_filter: dg.EventRecordsFilter, limit: int | None = None, ascending: bool = False
    ) -> Sequence[dg.EventLogRecord]:
        """Return events of any run; of runs with a file of their own those of assets, checks, and starts and ends."""
        return SqlEventLogStorage.get_event_records(self, event_records_filter, limit, ascending)

    def watch(
        self, run_id: str, cursor: str | None, callback: Callable[[dg.EventLogEntry, str], None]
    ) -> None:
        """Call back for each new event of a run: several runs write to a file, so it is asked, not watched."""
        self._watcher.watch_run(run_id, cursor, callback)

    def end_watch(self, run_id: str, handler: Callable[[dg.EventLogEntry, str], None]) -> None:
        """Call back no more."""
        self._watcher.unwatch_run(run_id, handler)

    def dispose(self) -> None:
        """End what watches."""
        if "_watcher" in self.__dict__:
            self._watcher.close()
        super().dispose()

    @property
    def is_run_sharded(self) -> bool:
        """Ids of events grow from run to run."""
        return False

    @cached_property
    def _thread(self) -> threading.local:
        return threading.local()

    @cached_property
    def _watcher(self) -> SqlPollingEventWatcher:
        return SqlPollingEventWatcher(self)

    def _has_own(self, run_id: str) -> bool:
        return Path(self.path_for_shard(run_id)).exists()


class ProjectStorage(DagsterSqliteStorage):
    """Runs, events and schedules in three SQLite files below `base_dir`; named by `storage: custom` in `dagster.yaml`."""

    _events: type[SqliteEventLogStorage] = ProjectEventLogStorage

    def __init__(self, base_dir: str, inst_data: ConfigurableClassData | None = None) -> None:
        runs, events, schedules = (Path(base_dir, name).absolute() for name in (RUNS, EVENTS, SCHEDULES))
        if not (runs.exists() and events.exists() and schedules.exists()):
            make_whole(Path(base_dir))
        self.base_dir, self._inst_data = base_dir, inst_data
        self._run_storage = _RunStorage(f"sqlite:///{runs}")
        self._event_log_storage = self._events(str(events.parent))
        self._schedule_storage = _ScheduleStorage(f"sqlite:///{schedules}")
        # Its own has Alembic look at each of them.
        super(DagsterSqliteStorage, self).__init__()  # type: ignore[no-untyped-call]  # Dagster's mixin has no annotations

    @classmethod
    def from_config_value(cls, inst_data: ConfigurableClassData | None, config_value: Any) -> Self:
        """Return the storage that `dagster.yaml` describes."""
        return cls.from_local(inst_data=inst_data, **config_value)


class ShardedStorage(ProjectStorage):
    """The same, but with a file for each run, as Dagster's `storage: sqlite` has it: for projects of before."""

    _events = _EventLogStorage
