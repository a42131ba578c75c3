"""Registering recordings as partitions, and removing them."""

from collections.abc import Sequence

import dagster as dg

from bagassets.defs.workspace import partitions_name
from bagassets.recipe.model import Recipe

__all__ = ["add_partitions", "remove_partition"]

# SQLite takes a limited number of variables in one statement.
_BATCH = 1000


def add_partitions(instance: dg.DagsterInstance, recipe: Recipe, keys: Sequence[str]) -> None:
    """Register recordings; those that are registered already stay."""
    for start in range(0, len(keys), _BATCH):
        instance.add_dynamic_partitions(partitions_name(recipe), list(keys[start : start + _BATCH]))


def remove_partition(instance: dg.DagsterInstance, recipe: Recipe, key: str) -> None:
    """Cancel the runs of a recording that is gone, then delete its partition."""
    unfinished = [
        dg.DagsterRunStatus.QUEUED,
        dg.DagsterRunStatus.NOT_STARTED,
        dg.DagsterRunStatus.STARTING,
        dg.DagsterRunStatus.STARTED,
    ]
    runs = instance.get_runs(dg.RunsFilter(statuses=unfinished, tags={"dagster/partition": key}))
    for run in runs:
        if run.status == dg.DagsterRunStatus.QUEUED:
            instance.report_run_canceled(run, message=f"Recording {key} was removed.")
        else:
            instance.run_launcher.terminate(run.run_id)
    instance.delete_dynamic_partition(partitions_name(recipe), key)
