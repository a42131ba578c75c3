"""Recordings as partitions: registering and removing them, and the runs that work on them."""

from collections.abc import Iterable, Sequence

import dagster as dg

from bagassets.defs.workspace import partitions_name
from bagassets.recipe.model import Recipe

__all__ = ["DATASET", "active_runs", "add_partitions", "remove_partition"]

DATASET = ""
"""Stands for the dataset among partition keys."""

# SQLite takes a limited number of variables in one statement.
_BATCH = 1000
_PARTITION_TAG = "dagster/partition"
_UNFINISHED = [
    dg.DagsterRunStatus.QUEUED,
    dg.DagsterRunStatus.NOT_STARTED,
    dg.DagsterRunStatus.STARTING,
    dg.DagsterRunStatus.STARTED,
]
_ACTIVE = [*_UNFINISHED, dg.DagsterRunStatus.CANCELING]


def active_runs(instance: dg.DagsterInstance, datasets: Iterable[str]) -> dict[str, str]:
    """Return run id -> partition key, or `DATASET` if it makes one of `datasets`, of runs that have not ended."""
    keys = {dg.AssetKey(name) for name in datasets}
    active = {}
    for run in instance.get_runs(filters=dg.RunsFilter(statuses=_ACTIVE)):
        if _PARTITION_TAG in run.tags:
            active[run.run_id] = run.tags[_PARTITION_TAG]
        elif keys & (run.asset_selection or set()):
            active[run.run_id] = DATASET
    return active


def add_partitions(instance: dg.DagsterInstance, recipe: Recipe, keys: Sequence[str]) -> None:
    """Register recordings; those that are registered already stay."""
    for start in range(0, len(keys), _BATCH):
        instance.add_dynamic_partitions(partitions_name(recipe), list(keys[start : start + _BATCH]))


def remove_partition(instance: dg.DagsterInstance, recipe: Recipe, key: str) -> None:
    """Cancel the runs of a recording that is gone, then delete its partition."""
    runs = instance.get_runs(dg.RunsFilter(statuses=_UNFINISHED, tags={_PARTITION_TAG: key}))
    for run in runs:
        if run.status == dg.DagsterRunStatus.QUEUED:
            instance.report_run_canceled(run, message=f"Recording {key} was removed.")
        else:
            instance.run_launcher.terminate(run.run_id)
    instance.delete_dynamic_partition(partitions_name(recipe), key)
