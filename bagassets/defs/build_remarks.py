"""What a build reports besides results: findings of checks, and warnings about the project."""

from collections.abc import Collection, Iterable, Iterator, Mapping

import dagster as dg

from bagassets.build.build_report import Remark

__all__ = ["remarks_of_runs", "warnings"]


def remarks_of_runs(instance: dg.DagsterInstance, run_ids: Collection[str]) -> list[Remark]:
    """Return the findings of the asset checks in some runs; empty ids are of recordings that had none."""
    remarks = []
    for run_id in sorted(filter(None, run_ids)):
        for entry in instance.all_logs(run_id, of_type=dg.DagsterEventType.ASSET_CHECK_EVALUATION):
            found = entry.get_dagster_event().asset_check_evaluation_data
            if not found.passed:
                severity = "error" if found.severity is dg.AssetCheckSeverity.ERROR else "warn"
                remarks.append(
                    Remark(found.partition or "", severity, found.check_name, _describe_finding(found))
                )
    return sorted(remarks, key=lambda remark: remark.key)


def warnings(found: Mapping[str, Iterable[str]]) -> Iterator[Remark]:
    """Yield what is not about a single recording, given as name -> sentences."""
    return (Remark("", "warn", name, one) for name, sentences in found.items() for one in sentences)


def _describe_finding(found: dg.AssetCheckEvaluation) -> str:
    more = int(str(found.metadata["problems"].value)) - 1 if "problems" in found.metadata else 0
    return (found.description or "") + (f" (and {more} more)" if more > 0 else "")
