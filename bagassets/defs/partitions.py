"""Recordings as dynamic partitions: registering them, removing them, and the active runs of each.

A recording on disk that is not registered yet is registered when a run asks for its partition.
"""

from collections.abc import Iterable, Sequence
from difflib import get_close_matches

import dagster as dg
from dagster import partition_loading_context

from bagassets.defs.batches import batch_of
from bagassets.defs.dagster_private import PartitionLoadingContext
from bagassets.errors import RecordingError
from bagassets.recipe.model import Bags, Recipe
from bagassets.recordings.discover import discover

__all__ = [
    "DATASET",
    "RecordingPartitions",
    "active_runs",
    "add_partitions",
    "partitions_name",
    "recording_partitions",
    "remove_partition",
]

DATASET = ""
"""Stands for the dataset among partition keys."""

_MOST_NAMED = 5
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


def partitions_name(recipe: Recipe) -> str:
    """Return the name of the recipe's dynamic partitions, which is global to the instance."""
    return f"{recipe.name}_recordings"


def recording_partitions(recipe: Recipe) -> dg.DynamicPartitionsDefinition:
    """Return the partitions of the assets of a recording: one key per recording."""
    partitions = RecordingPartitions(name=partitions_name(recipe))
    partitions.bags = recipe.bags
    return partitions


class RecordingPartitions(dg.DynamicPartitionsDefinition):
    """Dynamic partitions that a run may ask for before the sensor or a build has registered them.

    So `dagster asset materialize --partition KEY` works on a recording that was copied a moment ago.

    Attributes:
        bags: where recordings are found.
    """

    bags: Bags | None = None

    def __hash__(self) -> int:
        """Return the hash of plain dynamic partitions of this name, to which these are equal."""
        return hash(dg.DynamicPartitionsDefinition(name=self.name))

    __eq__ = dg.DynamicPartitionsDefinition.__eq__

    def validate_partition_key(self, partition_key: str, context: PartitionLoadingContext) -> None:
        """Accept a registered key, and register one whose recording is on disk.

        Raises:
            RecordingError: there is no such recording.
        """
        store = context.dynamic_partitions_store
        with partition_loading_context(new_ctx=context):
            is_registered = self.has_partition_key(partition_key)
        if is_registered or self.bags is None or not isinstance(store, dg.DagsterInstance):
            super().validate_partition_key(partition_key, context)
            return
        recordings = discover(self.bags).recordings
        if partition_key not in recordings:
            raise RecordingError(_no_such_recording(partition_key, self.bags, list(recordings)))
        store.add_dynamic_partitions(str(self.name), [partition_key])


def _no_such_recording(key: str, bags: Bags, known: list[str]) -> str:
    near = get_close_matches(key, known, n=1)
    if near:
        hint = f"did you mean {near[0]}?"
    elif known:
        more = f" and {len(known) - _MOST_NAMED} more" if len(known) > _MOST_NAMED else ""
        hint = f"the keys are {', '.join(known[:_MOST_NAMED])}{more}."
    else:
        hint = "there are no recordings at all."
    return f"{key}: no recording with this partition key below {bags.root}; {hint}"


def active_runs(instance: dg.DagsterInstance, datasets: Iterable[str]) -> dict[str, tuple[str, ...]]:
    """Return run id -> partition keys, and `DATASET` if it makes one of `datasets`, for runs that have not ended."""
    keys = {dg.AssetKey(name) for name in datasets}
    active: dict[str, tuple[str, ...]] = {}
    for run in instance.get_runs(filters=dg.RunsFilter(statuses=_ACTIVE)):
        if _PARTITION_TAG in run.tags:
            active[run.run_id] = (run.tags[_PARTITION_TAG],)
        elif keys & (run.asset_selection or set()):
            active[run.run_id] = (DATASET,)
        elif batch := batch_of(run):
            active[run.run_id] = batch
    return active


def add_partitions(instance: dg.DagsterInstance, recipe: Recipe, keys: Sequence[str]) -> None:
    """Register recordings; keys that are registered already are kept."""
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
