"""Recordings as dynamic partitions: registering them, removing them, and the active runs of each.

A recording on disk that is not registered yet is registered when a run asks for its partition.
"""

from collections.abc import Collection, Iterable, Sequence
from collections.abc import Set as AbstractSet
from contextlib import suppress
from difflib import get_close_matches

import click
import dagster as dg
from dagster import partition_loading_context
from sqlalchemy import and_, delete
from sqlalchemy.exc import IntegrityError

from bagassets.base.alike import names_text
from bagassets.base.errors import RecordingError
from bagassets.defs.dagster_private import (
    BulkActionsFilter,
    BulkActionStatus,
    DynamicPartitionsTable,
    PartitionLoadingContext,
    SqlEventLogStorage,
)
from bagassets.defs.records.batches import PARTITION_TAG, recordings_of
from bagassets.defs.records.events import Records, all_assets, in_batches
from bagassets.defs.records.naming import Naming
from bagassets.engine.batches import DATASET
from bagassets.recipe.model import Bags
from bagassets.recordings.discover import Discovery, discover

_UNFINISHED = [
    dg.DagsterRunStatus.QUEUED,
    dg.DagsterRunStatus.NOT_STARTED,
    dg.DagsterRunStatus.STARTING,
    dg.DagsterRunStatus.STARTED,
]
ACTIVE = [*_UNFINISHED, dg.DagsterRunStatus.CANCELING]
"""States of runs that have not ended."""


class PartitionError(RecordingError, click.ClickException):
    """Partitions that a run cannot be about; commands of Dagster's end with the sentence and without a traceback."""


def range_policy() -> dg.BackfillPolicy | None:
    """Return the policy without which `dagster asset materialize` and `dg launch` refuse a range; None if this is neither.

    They execute a range as one run, whatever would launch it.
    """
    context = click.get_current_context(silent=True)
    is_range = context is not None and context.params.get("partition_range")
    return dg.BackfillPolicy.single_run() if is_range else None


def recording_partitions(bags: Bags, names: Naming) -> dg.DynamicPartitionsDefinition:
    """Return the partitions of the assets of a recording: one key per recording."""
    partitions = RecordingPartitions(name=names.partitions)
    partitions.bags = bags
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
        """Accept a registered key, and register one whose recording is on disk; of a range, all others, too.

        Raises:
            PartitionError: there is no such recording.
        """
        store = context.dynamic_partitions_store
        with partition_loading_context(new_ctx=context):
            is_registered = self.has_partition_key(partition_key)
        if is_registered or self.bags is None or not isinstance(store, dg.DagsterInstance):
            super().validate_partition_key(partition_key, context)
            return
        found = discover(self.bags)
        if partition_key not in found.recordings:
            raise PartitionError(_no_such_recording(partition_key, self.bags, found))
        _register(store, str(self.name), list(found.recordings) if range_policy() else [partition_key])

    def get_partition_keys_in_range(self, partition_key_range: dg.PartitionKeyRange) -> Sequence[str]:
        """Return the keys of a range, in the order in which they were registered.

        Raises:
            PartitionError: its end was registered before its start, so Dagster would make nothing, and say nothing.
        """
        found = super().get_partition_keys_in_range(partition_key_range)
        if not found:
            start, end = partition_key_range.start, partition_key_range.end
            raise PartitionError(
                f"{start}...{end}: {end} was registered before {start}, so there is nothing in this range; write {end}...{start}."
            )
        return found


def _no_such_recording(key: str, bags: Bags, found: Discovery) -> str:
    known = list(found.recordings)
    if whole := found.joined_into(key):
        hint = f"it is part of {whole}, which is one recording."
    elif near := get_close_matches(key, known, n=1):
        hint = f"did you mean {near[0]}?"
    elif known:
        hint = f"the keys are {names_text(known)}."
    else:
        hint = "there are no recordings at all."
    return f"{key}: no recording with this partition key below {bags.root}; {hint}"


def active_runs(records: Records, datasets: Iterable[str]) -> dict[str, tuple[str, ...]]:
    """Return run id -> partition keys, and `DATASET` if it makes one of `datasets`, for runs that have not ended."""
    once, keys_of = frozenset(datasets), recordings_of(records)
    active: dict[str, tuple[str, ...]] = {}
    for run in records.instance.get_runs(filters=dg.RunsFilter(statuses=ACTIVE)):
        if keys := keys_of(run):
            active[run.run_id] = keys
        elif run.asset_selection and records.names.is_about(run, once):
            active[run.run_id] = (DATASET,)
    return active


def add_partitions(records: Records, keys: Sequence[str]) -> None:
    """Register recordings; keys that are registered already are kept."""
    _register(records.instance, records.names.partitions, keys)


def _register(instance: dg.DagsterInstance, partitions: str, keys: Sequence[str]) -> None:
    """Register partition keys, also while another process registers some of them.

    Dagster looks which of them are missing, then inserts those; in SQLite that fails if somebody was faster. Each time
    that happens one key more is known.
    """
    for batch in in_batches(keys):
        for _ in batch:
            with suppress(IntegrityError):
                instance.add_dynamic_partitions(partitions, batch)
                break
        else:
            instance.add_dynamic_partitions(partitions, batch)


def held_by_backfills(instance: dg.DagsterInstance, keys: AbstractSet[str]) -> dict[str, str]:
    """Return key -> what its removal waits for, for those partition keys that a backfill targets which has not ended.

    If one of them were deleted, Dagster would end all of that backfill as failed.
    """
    held: dict[str, str] = {}
    unfinished = [BulkActionStatus.REQUESTED, BulkActionStatus.CANCELING, BulkActionStatus.FAILING]
    for backfill in instance.get_backfills(BulkActionsFilter(statuses=unfinished)) if keys else ():
        data = backfill.asset_backfill_data
        subsets = () if data is None else data.target_subset.partitions_subsets_by_asset_key.values()
        # Of our partitions, which are dynamic, a subset is a set of keys.
        targeted = {key for subset in subsets for key in getattr(subset, "subset", ())}
        why = f"its partition is removed once backfill {backfill.backfill_id}, which targets it, has ended"
        held |= dict.fromkeys(keys & {*targeted, *(backfill.partition_names or ())}, why)
    return held


def remove_partitions(records: Records, keys: Collection[str]) -> None:
    """Cancel the runs of recordings that are gone, then delete their partitions."""
    instance, names = records.instance, records.names
    gone, assets = frozenset(keys), frozenset(all_assets())
    for run in instance.get_runs(dg.RunsFilter(statuses=_UNFINISHED)) if gone else ():
        key = run.tags.get(PARTITION_TAG)
        if key not in gone or not names.is_about(run, assets):
            continue
        if run.status == dg.DagsterRunStatus.QUEUED:
            instance.report_run_canceled(run, message=f"Recording {key} was removed.")
        else:
            instance.run_launcher.terminate(run.run_id)
    storage, of = instance.event_log_storage, names.partitions
    if not isinstance(storage, SqlEventLogStorage):
        for key in gone:
            instance.delete_dynamic_partition(of, key)
        return
    # As Dagster does, which has no way to delete more than one.
    table = DynamicPartitionsTable.c
    with storage.index_connection() as connection:
        for batch in in_batches(sorted(gone)):
            ours = and_(table.partitions_def_name == of, table.partition.in_(batch))
            connection.execute(delete(DynamicPartitionsTable).where(ours))
