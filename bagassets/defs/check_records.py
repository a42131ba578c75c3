"""Checks that passed, recorded where Dagster looks checks up, and not in the log of their run, too.

There are a dozen of each recording. Dagster would update and insert one at a time, and spell out what is empty or the same
in each: here they are one statement, and take two thirds of the room.
"""

import json
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any

import dagster as dg
from sqlalchemy.exc import IntegrityError

from bagassets.defs.dagster_private import AssetCheckExecutionsTable, SqlEventLogStorage

__all__ = ["record_passed"]

_SUCCEEDED = "SUCCEEDED"  # as Dagster's `AssetCheckExecutionRecordStatus` has it
_PARTS = ("dagster_event", "event_specific_data")  # of an event, one in the other


def record_passed(storage: SqlEventLogStorage, entries: Sequence[dg.EventLogEntry]) -> None:
    """Record evaluations of checks that passed.

    Args:
        storage: where to.
        entries: events with an `AssetCheckEvaluation` of a run each; they get no place in its log.
    """
    if not entries:
        return
    rows = [_row(entry) for entry in entries]
    try:
        with storage.index_connection() as connection:
            connection.execute(AssetCheckExecutionsTable.insert(), rows)
    except IntegrityError:  # the run has recorded one of them before
        for entry in entries:
            storage.store_asset_check_event(entry, None)


def _row(entry: dg.EventLogEntry) -> dict[str, Any]:
    evaluation: Any = entry.get_dagster_event().event_specific_data
    target = evaluation.target_materialization_data
    return {
        "asset_key": evaluation.asset_key.to_string(),
        "check_name": evaluation.check_name,
        "partition": evaluation.partition,
        "run_id": entry.run_id,
        "execution_status": _SUCCEEDED,
        "evaluation_event": _compact(dg.serialize_value(entry)),
        # Dagster has times in UTC without saying so, as PostgreSQL wants them.
        "evaluation_event_timestamp": datetime.fromtimestamp(entry.timestamp, UTC).replace(tzinfo=None),
        "evaluation_event_storage_id": None,
        "materialization_event_storage_id": None if target is None else target.storage_id,
    }


def _compact(serialized: str) -> str:
    """Return an event so that Dagster reads the same from it: what is absent is null by default."""
    event = json.loads(serialized)
    part = event
    for name in _PARTS:
        part[name] = {field: value for field, value in part[name].items() if value is not None}
        part = part[name]
    return json.dumps(event, separators=(",", ":"))
