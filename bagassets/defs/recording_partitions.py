"""Partitions by recording, which register themselves when somebody asks for one that lies on disk."""

from difflib import get_close_matches

import dagster as dg
from dagster import partition_loading_context
from dagster._core.definitions.partitions.context import PartitionLoadingContext

from bagassets.bags.discover import discover
from bagassets.errors import RecordingError
from bagassets.recipe.model import Bags, Recipe

__all__ = ["RecordingPartitions", "partitions_name", "recording_partitions"]

_MOST_NAMED = 5


def partitions_name(recipe: Recipe) -> str:
    """Return the name of the recipe's dynamic partitions; such names are global to an instance."""
    return f"{recipe.name}_recordings"


def recording_partitions(recipe: Recipe) -> dg.DynamicPartitionsDefinition:
    """Return the partitions of all assets per recording: one key per recording."""
    partitions = RecordingPartitions(name=partitions_name(recipe))
    partitions.bags = recipe.bags
    return partitions


class RecordingPartitions(dg.DynamicPartitionsDefinition):
    """Dynamic partitions for which a run may be asked for before a sensor or a build has registered them.

    So `dagster asset materialize --partition KEY` works on a recording that was copied just now.

    Attributes:
        bags: where recordings are found.
    """

    bags: Bags | None = None

    def __hash__(self) -> int:
        """Be the same as plain partitions of this name, to which these are equal."""
        return hash(dg.DynamicPartitionsDefinition(name=self.name))

    __eq__ = dg.DynamicPartitionsDefinition.__eq__

    def validate_partition_key(self, partition_key: str, context: PartitionLoadingContext) -> None:
        """Accept a registered key, and register one whose recording is there.

        Raises:
            RecordingError: there is no such recording.
        """
        store = context.dynamic_partitions_store
        with partition_loading_context(new_ctx=context):
            is_registered = self.has_partition_key(partition_key)
        if is_registered or self.bags is None or not isinstance(store, dg.DagsterInstance):
            super().validate_partition_key(partition_key, context)
            return
        found = discover(self.bags).found
        if partition_key not in found:
            raise RecordingError(_no_such_recording(partition_key, self.bags, list(found)))
        store.add_dynamic_partitions(str(self.name), [partition_key])


def _no_such_recording(key: str, bags: Bags, known: list[str]) -> str:
    near = get_close_matches(key, known, n=1)
    if near:
        hint = f"did you mean {near[0]}?"
    elif known:
        more = f" and {len(known) - _MOST_NAMED} more" if len(known) > _MOST_NAMED else ""
        hint = f"there are {', '.join(known[:_MOST_NAMED])}{more}."
    else:
        hint = "there is none at all."
    return f"{key}: no recording with this partition key below {bags.root}; {hint}"
