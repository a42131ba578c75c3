"""Reading Dagster's event log: what was recorded last for each asset partition.

Which artifact is current is said only here.
"""

import json
from collections.abc import Iterable, Mapping

import dagster as dg
from dagster import AssetRecordsFilter

from bagassets.bags.digest import RecordingStat
from bagassets.defs.workspace import partitions_name
from bagassets.engine.plan import RECORDING_ASSETS, Recorded
from bagassets.errors import StoreError
from bagassets.recipe.model import Recipe
from bagassets.store.artifact import Artifact
from bagassets.store.store import Store

__all__ = ["live_partitions", "recorded_artifact", "recorded_partition", "recorded_states"]

DATA_VERSION = "dagster/data_version"
CODE_VERSION = "dagster/code_version"
INPUT_PREFIX = "dagster/input_data_version/"
STAT = "file_stat"

# Records are fetched by storage id; more ids at a time exceed SQLite's variables.
_BATCH = 500


def live_partitions(instance: dg.DagsterInstance, recipe: Recipe) -> frozenset[str]:
    """Return the registered partition keys."""
    return frozenset(instance.get_dynamic_partitions(partitions_name(recipe)))


def recorded_states(
    instance: dg.DagsterInstance, assets: Iterable[str] = RECORDING_ASSETS
) -> dict[str, dict[str, Recorded]]:
    """Return asset -> partition key -> latest record, in bulk.

    Partitions that were deleted are included; intersect with the live ones.
    """
    return {asset: _latest(instance, dg.AssetKey(asset)) for asset in assets}


def recorded_partition(instance: dg.DagsterInstance, asset: str, partition_key: str) -> Recorded | None:
    """Return the latest record of one asset partition."""
    result = instance.fetch_materializations(
        AssetRecordsFilter(asset_key=dg.AssetKey(asset), asset_partitions=[partition_key]), limit=1
    )
    for record in result.records:
        if record.asset_materialization is not None:
            return _recorded(record.asset_materialization, record.run_id)
    return None


def recorded_artifact(instance: dg.DagsterInstance, store: Store, asset: str, partition_key: str) -> Artifact:
    """Return the artifact that is current for an asset partition.

    Raises:
        StoreError: nothing is recorded, or the artifact is not in the store.
    """
    recorded = recorded_partition(instance, asset, partition_key)
    if recorded is None:
        raise StoreError(
            f"{partition_key}: {asset} is not materialized for this recording; materialize it first."
        )
    return store.artifact(recorded.data_version)


def _latest(instance: dg.DagsterInstance, key: dg.AssetKey) -> dict[str, Recorded]:
    storage = instance.event_log_storage
    ids = storage.get_latest_storage_id_by_partition(key, dg.DagsterEventType.ASSET_MATERIALIZATION)
    wanted = sorted(ids.values())
    latest = {}
    for start in range(0, len(wanted), _BATCH):
        batch = wanted[start : start + _BATCH]
        result = instance.fetch_materializations(
            AssetRecordsFilter(asset_key=key, storage_ids=batch), limit=len(batch)
        )
        for record in result.records:
            materialization = record.asset_materialization
            if materialization is not None and materialization.partition is not None:
                latest[materialization.partition] = _recorded(materialization, record.run_id)
    return latest


def _recorded(materialization: dg.AssetMaterialization, run_id: str) -> Recorded:
    tags: Mapping[str, str] = materialization.tags or {}
    stat = materialization.metadata.get(STAT)
    cached = materialization.metadata.get("cached")
    action = materialization.metadata.get("action_digest")
    inputs = {
        name.removeprefix(INPUT_PREFIX): version
        for name, version in tags.items()
        if name.startswith(INPUT_PREFIX)
    }
    return Recorded(
        data_version=tags.get(DATA_VERSION, ""),
        code_version=tags.get(CODE_VERSION),
        inputs=inputs,
        stat=None if stat is None else RecordingStat.from_json(json.loads(str(stat.value))),
        cached=None if cached is None else bool(cached.value),
        action=None if action is None else str(action.value),
        run_id=run_id,
    )
