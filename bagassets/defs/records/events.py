"""Reading Dagster's event log: the latest record of each asset partition.

Only the event log says which artifact is current.
"""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import dagster as dg
from dagster import AssetRecordsFilter

from bagassets.defs.records.naming import INPUT_PREFIX, AssetName, Naming
from bagassets.engine.plan import Recorded
from bagassets.formats.catalogue import known_assets
from bagassets.recordings.digest import RecordingStat

A = TypeVar("A", bound=AssetName)
T = TypeVar("T")

DATA_VERSION = "dagster/data_version"
CODE_VERSION = "dagster/code_version"
STAT = "file_stat"
MADE_ALONG = "inventory_action"
CONTENT, SEVERAL = "content_digest", "several"
REASON = "reason"
NOT_MADE = "not_made"
CACHED, _ACTION = "cached", "action_digest"
_OF_RECORDED = {STAT, CACHED, _ACTION, MADE_ALONG, CONTENT, REASON}

# Records are fetched by storage id; more ids at a time would exceed SQLite's limit of variables.
_BATCH = 500
_NOT_SUCCEEDED = [dg.DagsterRunStatus.FAILURE, dg.DagsterRunStatus.CANCELED]


def all_assets() -> tuple[str, ...]:
    """Return the assets that recordings may have, whether the recipe asks for them now or not."""
    return ("bag", *(asset.name for asset in known_assets()))


@dataclass(frozen=True)
class Records:
    """What a Dagster instance has on record of a project.

    Attributes:
        instance: the instance.
        names: what the project is called there.
    """

    instance: dg.DagsterInstance
    names: Naming

    def live(self) -> frozenset[str]:
        """Return the registered partition keys."""
        return frozenset(self.instance.get_dynamic_partitions(self.names.partitions))

    def states(self, assets: Iterable[A]) -> dict[A, dict[str, Recorded]]:
        """Return asset -> partition key -> latest record, in bulk.

        Partitions that were deleted are included; intersect with the live ones.
        """
        ids = self.latest_ids(assets)
        records = self.fetch(ids, {key for by_key in ids.values() for key in by_key})
        return {asset: {key: made[asset] for key, made in records.items() if asset in made} for asset in ids}

    def of(self, asset: AssetName, partition_key: str) -> Recorded | None:
        """Return the latest record of one asset partition."""
        about = AssetRecordsFilter(asset_key=self.names.key(asset), asset_partitions=[partition_key])
        records = self.instance.fetch_materializations(about, limit=1).records
        late = self._late(records)
        for record in records:
            if record.asset_materialization is not None and record.storage_id not in late:
                return self._recorded(record.asset_materialization, record.run_id)
        return None

    def last_failure(self, asset: str, key: str) -> str | None:
        """Return why an asset of a recording was not made when that was last tried; None if it is not known."""
        about = AssetRecordsFilter(asset_key=self.names.key(asset), asset_partitions=[key])
        for record in self.instance.fetch_observations(about, limit=1).records:
            if record.asset_observation is not None and NOT_MADE in record.asset_observation.metadata:
                return record.asset_observation.description
        return None

    def whole(self, asset: AssetName) -> Recorded | None:
        """Return the latest record of an asset, whichever partition it is of."""
        return self.wholes([asset]).get(asset)

    def wholes(self, assets: Iterable[A]) -> dict[A, Recorded]:
        """Return asset -> its latest record, of some assets in one query; see `whole`."""
        keys = {self.names.key(asset): asset for asset in assets}
        latest = self.instance.event_log_storage.get_latest_materialization_events(list(keys))
        return {
            keys[key]: self._recorded(made, event.run_id)
            for key, event in latest.items()
            if event is not None and (made := event.asset_materialization) is not None
        }

    def latest_ids(self, assets: Iterable[A], *, of: set[str] | None = None) -> dict[A, Mapping[str, int]]:
        """Return asset -> partition key -> storage id of the latest materialization (20 ms for 10,000 partitions).

        Partitions that were deleted are included; intersect with the live ones.

        Args:
            assets: which.
            of: partition keys; default: all.
        """
        latest, key_of = self.instance.event_log_storage.get_latest_storage_id_by_partition, self.names.key
        kind = dg.DagsterEventType.ASSET_MATERIALIZATION
        return {asset: latest(key_of(asset), kind, of) for asset in assets}

    def fetch(self, ids: Mapping[A, Mapping[str, int]], keys: Iterable[str]) -> dict[str, dict[A, Recorded]]:
        """Return partition key -> asset -> latest record, for the storage ids that `latest_ids` gave."""
        found: dict[str, dict[A, Recorded]] = {key: {} for key in keys}
        records: list[tuple[A, dg.EventLogRecord]] = []
        for asset, by_key in ids.items():
            wanted = sorted(by_key[key] for key in found if key in by_key)
            for batch in in_batches(wanted):
                about = AssetRecordsFilter(asset_key=self.names.key(asset), storage_ids=batch)
                result = self.instance.fetch_materializations(about, limit=len(batch))
                records += [(asset, record) for record in result.records]
        late = self._late([record for _, record in records])
        for asset, record in records:
            made = record.asset_materialization
            if made is not None and made.partition in found and record.storage_id not in late:
                found[made.partition][asset] = self._recorded(made, record.run_id)
        return found

    def of_recording(self, key: str) -> Mapping[str, Recorded]:
        """Return asset -> latest record of one recording; nothing if it is not registered."""
        return self.fetch(self.latest_ids(all_assets(), of={key}), [key])[key] if key in self.live() else {}

    def _late(self, records: Sequence[dg.EventLogRecord]) -> set[int]:
        """Return the ids of records that were written after their run had been given up (see `fence`).

        These count as none: what they say may be older than what a retry has recorded. To record something once more does
        no harm.
        """
        run_ids = sorted({record.run_id for record in records})
        ends: dict[str, float | None] = {}
        for batch in in_batches(run_ids):
            asked = dg.RunsFilter(run_ids=batch, statuses=_NOT_SUCCEEDED)
            ends |= {one.dagster_run.run_id: one.end_time for one in self.instance.get_run_records(asked)}
        return {
            record.storage_id
            for record in records
            if (end_s := ends.get(record.run_id)) is not None and record.timestamp > end_s
        }

    def _recorded(self, materialization: dg.AssetMaterialization, run_id: str) -> Recorded:
        tags: Mapping[str, str] = materialization.tags or {}
        metadata = materialization.metadata
        said = {name: value.value for name, value in metadata.items() if name in _OF_RECORDED}
        inputs = {name: version for name, version in tags.items() if name.startswith(INPUT_PREFIX)}
        return Recorded(
            data_version=tags.get(DATA_VERSION, ""),
            code_version=tags.get(CODE_VERSION),
            inputs={self.names.input_of(name): version for name, version in inputs.items()},
            stat=RecordingStat.from_json(json.loads(str(said[STAT]))) if STAT in said else None,
            cached=bool(said[CACHED]) if CACHED in said else None,
            action=str(said[_ACTION]) if _ACTION in said else None,
            run_id=run_id,
            made_along=str(said.get(MADE_ALONG, "")),
            content=str(said.get(CONTENT, "")),
            why_skipped=str(said.get(REASON, "")),
        )


def recordings_made(instance: dg.DagsterInstance, run_id: str) -> frozenset[str]:
    """Return the partition keys of which a run has made something, rather than recorded what was known."""
    entries = instance.all_logs(run_id, of_type=dg.DagsterEventType.ASSET_MATERIALIZATION)
    logged = (entry.asset_materialization for entry in entries)
    found = [one for one in logged if one is not None and CACHED in one.metadata]
    return frozenset(one.partition or "" for one in found if not one.metadata[CACHED].value)


def event_database(instance: dg.DagsterInstance) -> Path | None:
    """Return the SQLite file with the events of assets; None if they are kept elsewhere."""
    path_for_shard = getattr(instance.event_log_storage, "path_for_shard", None)
    return None if path_for_shard is None else Path(path_for_shard("index"))


def runs_of(instance: dg.DagsterInstance, run_ids: Iterable[str]) -> list[dg.DagsterRun]:
    """Return the runs with these ids that are there."""
    batches = in_batches(sorted(run_ids))
    return [run for batch in batches for run in instance.get_runs(dg.RunsFilter(run_ids=batch))]


def in_batches(ids: Sequence[T]) -> Iterator[list[T]]:
    """Yield the ids in lists so short that a query may name all of one."""
    for start in range(0, len(ids), _BATCH):
        yield list(ids[start : start + _BATCH])
