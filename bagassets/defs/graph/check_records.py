"""Checks of recordings where Dagster looks them up: those that passed recorded, and all of them read, many at a time.

There are a dozen of each recording. Dagster would update and insert one at a time, and spell out what is empty: here they
are one statement, and take a quarter less room; they are not in the log of their run, too.
"""

import json
from collections import Counter, defaultdict
from collections.abc import Collection, Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

import dagster as dg
from sqlalchemy.exc import IntegrityError

from bagassets.defs.dagster_private import AssetCheckExecutionsTable, SqlEventLogStorage
from bagassets.defs.graph.checks import check_groups
from bagassets.defs.records.workspace import Workspace
from bagassets.engine.build_report import Remark
from bagassets.report.model import Problem

__all__ = ["findings_on_record", "record_passed", "remarks_of_runs"]

_SUCCEEDED, _FAILED = "SUCCEEDED", "FAILED"  # as Dagster's `AssetCheckExecutionRecordStatus` has them
_BATCH = 500
_PARTS = ("dagster_event", "event_specific_data")  # of an event, one in the other


def record_passed(storage: SqlEventLogStorage, entries: Sequence[dg.EventLogEntry]) -> None:
    """Record evaluations of checks that passed.

    Args:
        storage: where to.
        entries: events with an `AssetCheckEvaluation` of a run each; they get no place in its log.
    """
    if not entries:
        return
    # Dagster finds by the id of its event what is new, and ignores a check that has none; these have the latest one.
    latest_id = storage.get_maximum_record_id()
    # For the database, no partition differs from no partition, so it would not refuse the same check twice.
    one_by_one = [entry for entry in entries if _evaluation(entry).partition is None]
    together = [_row(entry, latest_id) for entry in entries if _evaluation(entry).partition is not None]
    try:
        if together:
            with storage.index_connection() as connection:
                connection.execute(AssetCheckExecutionsTable.insert(), together)
    except IntegrityError:  # the run has recorded one of them before
        one_by_one = [*entries]
    for entry in one_by_one:
        storage.store_asset_check_event(entry, latest_id)


def _evaluation(entry: dg.EventLogEntry) -> Any:
    return entry.get_dagster_event().event_specific_data


def _row(entry: dg.EventLogEntry, latest_id: int | None) -> dict[str, Any]:
    evaluation = _evaluation(entry)
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
        "evaluation_event_storage_id": latest_id,
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


def findings_on_record(
    instance: dg.DagsterInstance, workspace: Workspace
) -> tuple[Mapping[str, Sequence[Problem]], Mapping[str, int]]:
    """Return recording -> what its checks found, and how many found nothing, if they ran on what is recorded last."""
    storage, names = instance.event_log_storage, workspace.names
    groups = [group for of in check_groups(workspace.recipe).values() for group in of.items()]
    checks = [dg.AssetCheckKey(names.key(asset), one.name) for asset, of_asset in groups for one in of_asset]
    latest = [
        (info.check_key, info.partition_key, info.latest_execution_status)
        for info in storage.get_asset_check_partition_info(checks)
        if info.partition_key is not None and info.is_current
    ]
    problems: defaultdict[str, list[Problem]] = defaultdict(list)
    for check in checks:
        wanted = {key: status for one, key, status in latest if one == check and status.value == _FAILED}
        cursor = None
        while wanted:  # newest first, so that the first of a recording is the one that counts
            history = storage.get_asset_check_execution_history(check, _BATCH, cursor, {*wanted.values()})
            for record in history:
                if record.partition in wanted and record.event is not None:
                    del wanted[record.partition]
                    problems[record.partition].append(_problem(_evaluation(record.event)))
            if len(history) < _BATCH:
                break
            cursor = history[-1].id
    return problems, Counter(key for _, key, status in latest if status.value == _SUCCEEDED)


def remarks_of_runs(instance: dg.DagsterInstance, run_ids: Collection[str]) -> list[Remark]:
    """Return the findings of the asset checks in some runs; empty ids are of recordings that had none."""
    remarks = []
    for run_id in sorted(filter(None, run_ids)):
        for entry in instance.all_logs(run_id, of_type=dg.DagsterEventType.ASSET_CHECK_EVALUATION):
            found = _evaluation(entry)
            if not found.passed:
                one = _problem(found)
                said = one.sentence + (f" (and {one.more} more)" if one.more > 0 else "")
                remarks.append(Remark(found.partition or "", one.weight, one.check, said))
    return sorted(remarks, key=lambda remark: remark.key)


def _problem(evaluation: Any) -> Problem:
    """Return what a check found; users' own checks need not count their problems."""
    more = int(str(evaluation.metadata["problems"].value)) - 1 if "problems" in evaluation.metadata else 0
    weight = evaluation.severity.value.lower()
    return Problem(evaluation.check_name, weight, evaluation.description or "", more)
