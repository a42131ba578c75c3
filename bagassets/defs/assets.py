"""The assets of one recording: `bag`, the ones that read it, and its nuScenes tables."""

import json
from collections.abc import Iterator

import dagster as dg

from bagassets.bags.digest import recording_digest, recording_stat
from bagassets.defs.descriptions import DESCRIPTIONS, KINDS
from bagassets.defs.events import STAT, recorded_artifact, recorded_partition
from bagassets.defs.exclusive import RecordingLock
from bagassets.defs.markdown import human_size
from bagassets.defs.pictures import picture_metadata
from bagassets.defs.reporting import failures_in_words, result_metadata
from bagassets.defs.workspace import Workspace, recording_partitions
from bagassets.engine.code_version import code_version
from bagassets.engine.recording_assets import ASSETS, OPTIONAL_ASSETS, UPSTREAM, Skipped, assets_of
from bagassets.engine.recording_build import RecordingBuild
from bagassets.errors import StoreError
from bagassets.escaping import visible
from bagassets.recipe.model import Recipe

__all__ = ["recording_assets"]

GROUP = "recording"
# Made together, because passes over the recording are what costs.
_EXTRACTED = tuple(asset for asset in ASSETS if asset != "nuscenes_tables")


def recording_assets(recipe: Recipe) -> list[dg.AssetsDefinition]:
    """Return the assets that exist once per recording."""
    partitions = recording_partitions(recipe)

    @dg.asset(
        name="bag",
        partitions_def=partitions,
        group_name=GROUP,
        kinds=KINDS["bag"],
        description=DESCRIPTIONS["bag"],
        code_version="1",
    )
    def bag(
        context: dg.AssetExecutionContext, workspace: Workspace, recording_lock: RecordingLock
    ) -> dg.MaterializeResult[None]:
        with failures_in_words():
            recording_lock.take(context)
            found = workspace.found(context.partition_key)
            stat = recording_stat(found)
            digest = recording_digest(found, workspace.index)
            return dg.MaterializeResult(
                data_version=dg.DataVersion(digest.digest),
                metadata={
                    "path": dg.MetadataValue.path(str(found.path)),
                    "format": found.format,
                    "size": human_size(found.size),
                    "size_bytes": found.size,
                    "files": len(found.files),
                    "digest": digest.digest,
                    "hashed_bytes": digest.hashed_bytes,
                    STAT: dg.MetadataValue.text(json.dumps(stat.as_json())),
                },
            )

    @dg.multi_asset(
        name="extract",
        can_subset=True,
        partitions_def=partitions,
        specs=[_spec(recipe, asset, skippable=True) for asset in _EXTRACTED],
    )
    def extract(
        context: dg.AssetExecutionContext, workspace: Workspace, recording_lock: RecordingLock
    ) -> Iterator[dg.MaterializeResult[None]]:
        wanted = {key.to_user_string() for key in context.selected_asset_keys}
        with failures_in_words():
            yield from _build(context, workspace, recording_lock, wanted)

    @dg.multi_asset(
        name="tables",
        partitions_def=partitions,
        specs=[_spec(recipe, "nuscenes_tables", skippable=True)],
    )
    def tables(
        context: dg.AssetExecutionContext, workspace: Workspace, recording_lock: RecordingLock
    ) -> Iterator[dg.MaterializeResult[None]]:
        with failures_in_words():
            yield from _build(context, workspace, recording_lock, {"nuscenes_tables"})

    optional = [_optional_asset(recipe, asset) for asset in assets_of(recipe) if asset in OPTIONAL_ASSETS]
    return [bag, extract, tables, *optional]


def _optional_asset(recipe: Recipe, asset: str) -> dg.AssetsDefinition:
    @dg.multi_asset(
        name=f"make_{asset}",
        partitions_def=recording_partitions(recipe),
        specs=[_spec(recipe, asset, skippable=True)],
    )
    def make(
        context: dg.AssetExecutionContext, workspace: Workspace, recording_lock: RecordingLock
    ) -> Iterator[dg.MaterializeResult[None]]:
        with failures_in_words():
            yield from _build(context, workspace, recording_lock, {asset})

    return make


def _spec(recipe: Recipe, asset: str, *, skippable: bool) -> dg.AssetSpec:
    return dg.AssetSpec(
        asset,
        # The rest follows the recording through its inventory, which has a digest of each topic: so a
        # recording that was only indexed or compressed anew leaves them fresh, for Dagster's markers too.
        deps=list(UPSTREAM[asset]) or ["bag"],
        group_name=GROUP,
        kinds=KINDS[asset],
        description=DESCRIPTIONS[asset],
        code_version=code_version(recipe, asset),
        skippable=skippable,
    )


def _build(
    context: dg.AssetExecutionContext, workspace: Workspace, recording_lock: RecordingLock, wanted: set[str]
) -> Iterator[dg.MaterializeResult[None]]:
    key = context.partition_key
    recording_lock.take(context)
    record = recorded_partition(context.instance, "bag", key)
    if record is None or record.stat is None:
        raise StoreError(f"{key}: bag is not materialized for this recording; materialize bag first.")
    upstream = {name for asset in wanted for name in UPSTREAM[asset]} - wanted
    recorded = {
        name: recorded_artifact(context.instance, workspace.store, name, key)
        for name in sorted(upstream)
        if recorded_partition(context.instance, name, key) is not None
    }
    build = RecordingBuild(
        workspace.recipe, workspace.store, workspace.found(key), record.data_version, record.stat, recorded
    )
    for made in build.build(wanted):
        if isinstance(made, Skipped):
            context.log.info("%s is skipped: %s.", key, visible(made.reason))
            return
        skipped = {"skipped": build.skipped} if made.asset == "inventory" and build.skipped else {}
        yield dg.MaterializeResult(
            asset_key=made.asset,
            data_version=dg.DataVersion(made.artifact.digest),
            metadata=result_metadata(made) | picture_metadata(made) | skipped,
        )
