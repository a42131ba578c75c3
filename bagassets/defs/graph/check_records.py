"""Checks of recordings as they are on record, read many at a time."""

from collections import Counter, defaultdict
from collections.abc import Collection, Mapping, Sequence

import dagster as dg

from bagassets.defs.graph.checks import FAILED, wanted_checks
from bagassets.defs.records.workspace import Workspace
from bagassets.engine.build_report import Remark
from bagassets.report.model import Problem

_SUCCEEDED = "SUCCEEDED"  # as Dagster's `AssetCheckExecutionRecordStatus` has it
_BATCH = 500


def findings_on_record(
    workspace: Workspace,
) -> tuple[Mapping[str, Sequence[Problem]], Mapping[str, int]]:
    """Return recording -> what its checks found, and how many found nothing, if they ran on what is recorded last."""
    storage, names = workspace.instance.event_log_storage, workspace.names
    checks = [
        dg.AssetCheckKey(names.key(asset), one.name)
        for asset, of_asset in wanted_checks(workspace.recipe).items()
        for one in of_asset
    ]
    latest = [
        (info.check_key, info.partition_key, info.latest_execution_status)
        for info in storage.get_asset_check_partition_info(checks)
        if info.partition_key is not None and info.is_current
    ]
    problems: defaultdict[str, list[Problem]] = defaultdict(list)
    for check in checks:
        wanted = {key: status for one, key, status in latest if one == check and status.value == FAILED}
        cursor = None
        while wanted:  # newest first, so that the first of a recording is the one that counts
            history = storage.get_asset_check_execution_history(check, _BATCH, cursor, {*wanted.values()})
            for record in history:
                if record.partition in wanted and record.evaluation is not None:
                    del wanted[record.partition]
                    problems[record.partition].append(_problem(record.evaluation))
            if len(history) < _BATCH:
                break
            cursor = history[-1].id
    return problems, Counter(key for _, key, status in latest if status.value == _SUCCEEDED)


def remarks_of_runs(instance: dg.DagsterInstance, run_ids: Collection[str]) -> list[Remark]:
    """Return the findings of the asset checks in some runs; empty ids are of recordings that had none."""
    remarks = []
    for run_id in sorted(filter(None, run_ids)):
        for entry in instance.all_logs(run_id, of_type=dg.DagsterEventType.ASSET_CHECK_EVALUATION):
            found = entry.asset_check_evaluation
            if found is not None and not found.passed:
                one = _problem(found)
                said = one.sentence + (f" (and {one.more} more)" if one.more > 0 else "")
                remarks.append(Remark(found.partition or "", one.weight, one.check, said))
    return sorted(remarks, key=lambda remark: remark.key)


def _problem(evaluation: dg.AssetCheckEvaluation) -> Problem:
    """Return what a check found; users' own checks need not count their problems."""
    more = int(str(evaluation.metadata["problems"].value)) - 1 if "problems" in evaluation.metadata else 0
    weight = evaluation.severity.value.lower()
    return Problem(evaluation.check_name, weight, evaluation.description or "", more)
