"""What the checks of runs have found."""

from collections.abc import Collection

import dagster as dg

from bagassets.engine.build_report import Remark


def remarks_of_runs(instance: dg.DagsterInstance, run_ids: Collection[str]) -> list[Remark]:
    """Return the findings of the asset checks in some runs; empty ids are of recordings that had none."""
    remarks = []
    for run_id in sorted(filter(None, run_ids)):
        for entry in instance.all_logs(run_id, of_type=dg.DagsterEventType.ASSET_CHECK_EVALUATION):
            found = entry.asset_check_evaluation
            if found is not None and not found.passed:
                # Users' own checks need not count their problems.
                number = found.metadata.get("problems")
                more = 0 if number is None else int(str(number.value)) - 1
                said = (found.description or "") + (f" (and {more} more)" if more > 0 else "")
                weight = found.severity.value.lower()
                remarks.append(Remark(found.partition or "", weight, found.check_name, said))
    return sorted(remarks, key=lambda remark: remark.key)
