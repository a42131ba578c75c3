"""What asset checks found in runs, as a build tells it at its end."""

from collections.abc import Iterator, Mapping

import dagster as dg

from bagassets.engine.build_report import Remark

__all__ = ["remarks"]


def remarks(instance: dg.DagsterInstance, runs: Mapping[str, str | None]) -> Iterator[Remark]:
    """Yield what the checks that some runs made found.

    Args:
        instance: where the runs are on record.
        runs: partition key -> its run; None if there was none.
    """
    for key, run_id in sorted(runs.items()):
        if run_id is None:
            continue
        for entry in instance.all_logs(run_id, of_type=dg.DagsterEventType.ASSET_CHECK_EVALUATION):
            found = entry.get_dagster_event().asset_check_evaluation_data
            if not found.passed:
                severity = "error" if found.severity is dg.AssetCheckSeverity.ERROR else "warn"
                yield Remark(key, severity, found.check_name, _told(found))


def _told(found: dg.AssetCheckEvaluation) -> str:
    more = int(str(found.metadata["problems"].value)) - 1 if "problems" in found.metadata else 0
    return (found.description or "") + (f" (and {more} more)" if more > 0 else "")
