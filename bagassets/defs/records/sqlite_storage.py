"""Dagster's records in SQLite with the events of all runs in one database.

Dagster gives each run a database of its own, and copies into a common one what it says of assets: empty tables and
indexes for every run, and each materialization and check twice. Here new runs write to the common one alone, as they do in
PostgreSQL. Runs that have a database of their own keep it, so a project of before needs no conversion: it changes over
when its `dagster.yaml` names this storage.
"""

import threading
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import dagster as dg

from bagassets.defs.dagster_private import (
    ASSET_EVENTS,
    ConfigurableClassData,
    DagsterSqliteStorage,
    SqlEventLogStorage,
    SqliteEventLogStorage,
    SqlPollingEventWatcher,
)

__all__ = ["ProjectEventLogStorage", "ProjectStorage"]

_COMMON = "index"


class ProjectEventLogStorage(SqliteEventLogStorage):
    """The events of all runs in one SQLite file, but for runs that have a file of their own."""

    def run_connection(self, run_id: str | None = None) -> Any:
        """Return a connection to the events of a run."""
        return self._connect(run_id if run_id is not None and self._has_own(run_id) else _COMMON)

    def index_connection(self) -> Any:
        """Return a connection to the events of all runs; within `store_event`, the one it already holds."""
        held = getattr(self._thread, "connection", None)
        return super().index_connection() if held is None else nullcontext(held)

    def store_event(self, event: dg.EventLogEntry) -> None:
        """Record an event once; that of an asset in one transaction with what finds it."""
        self._thread.event_id = None
        if self._has_own(event.run_id):
            super().store_event(event)  # a run that was begun before the change
        elif event.dagster_event is None or event.dagster_event.event_type not in ASSET_EVENTS:
            SqlEventLogStorage.store_event(self, event)
        else:
            with self._connect(_COMMON) as connection:
                stored = connection.execute(self.prepare_insert_event(event))
                event_id = stored.inserted_primary_key[0]  # type: ignore[index]  # of an insert never None
                if event.dagster_event.asset_key is not None:
                    self._thread.connection = connection
                    try:
                        self.store_asset_event(event, event_id)
                        self.store_asset_event_tags([event], [event_id])
                    finally:
                        self._thread.connection = None
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

    def __init__(self, base_dir: str, inst_data: ConfigurableClassData | None = None) -> None:
        super().__init__(base_dir, inst_data)
        self._event_log_storage = ProjectEventLogStorage(str(Path(base_dir, "history", "runs")))

    @classmethod
    def from_config_value(cls, inst_data: ConfigurableClassData | None, config_value: Any) -> Self:
        """Return the storage that `dagster.yaml` describes."""
        return cls.from_local(inst_data=inst_data, **config_value)
