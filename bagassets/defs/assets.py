"""The assets of a recording as Dagster assets: `bag`, those extracted from it, and those made from these."""

from collections.abc import Iterator

import dagster as dg

from bagassets.assets.asset import AnyAsset
from bagassets.build.execute import Skipped, execute
from bagassets.build.graph import SELECTION, Graph
from bagassets.build.recording_assets import RecordingAssets
from bagassets.defs.events import recorded_artifact, recorded_partition
from bagassets.defs.exclusive import RecordingLock
from bagassets.defs.partitions import recording_partitions
from bagassets.defs.reporting import BAG_CODE_VERSION, bag_metadata, errors_explained, result_metadata
from bagassets.defs.workspace import Workspace
from bagassets.errors import StoreError
from bagassets.escaping import visible
from bagassets.formats.catalogue import recording_assets
from bagassets.recipe.model import Recipe
from bagassets.recordings.digest import recording_digest, recording_stat

__all__ = ["recording_definitions"]

GROUP = "recording"
_BAG = """A recording: a ROS 1 bag, a ROS 2 bag or an MCAP file.

Its data version is the digest of its content; each file is hashed once. Touching a file does not change it."""
# Operations of assets that are not called `make_<asset>` in the runs on record.
_OPERATIONS = {"nuscenes_tables": "tables"}


def recording_definitions(recipe: Recipe) -> list[dg.AssetsDefinition]:
    """Return the assets that exist once per recording."""
    partitions = recording_partitions(recipe)
    assets = recording_assets(recipe)

    @dg.asset(
        name="bag",
        partitions_def=partitions,
        group_name=GROUP,
        kinds={"ros", "file"},
        description=_BAG,
        code_version=BAG_CODE_VERSION,
    )
    def bag(
        context: dg.AssetExecutionContext, workspace: Workspace, recording_lock: RecordingLock
    ) -> dg.MaterializeResult[None]:
        with errors_explained():
            recording_lock.take(context)
            recording = workspace.recording(context.partition_key)
            stat = recording_stat(recording)
            digest = recording_digest(recording, workspace.index)
            return dg.MaterializeResult(
                data_version=dg.DataVersion(digest.digest),
                metadata=bag_metadata(recording, stat, digest),
            )

    @dg.multi_asset(
        name="extract",
        can_subset=True,
        partitions_def=partitions,
        specs=[_spec(assets, asset) for asset in assets if asset.name in assets.extracted],
    )
    def extract(
        context: dg.AssetExecutionContext, workspace: Workspace, recording_lock: RecordingLock
    ) -> Iterator[dg.MaterializeResult[None]]:
        wanted = {key.to_user_string() for key in context.selected_asset_keys}
        with errors_explained():
            yield from _build(context, workspace, recording_lock, wanted)

    return [
        bag,
        extract,
        *(_definition(assets, asset) for asset in assets if asset.name not in assets.extracted),
    ]


def _definition(assets: RecordingAssets, asset: AnyAsset) -> dg.AssetsDefinition:
    """Return the definition of an asset that has an operation of its own."""

    @dg.multi_asset(
        name=_OPERATIONS.get(asset.name, f"make_{asset.name}"),
        partitions_def=recording_partitions(assets.recipe),
        specs=[_spec(assets, asset)],
    )
    def make(
        context: dg.AssetExecutionContext, workspace: Workspace, recording_lock: RecordingLock
    ) -> Iterator[dg.MaterializeResult[None]]:
        with errors_explained():
            yield from _build(context, workspace, recording_lock, {asset.name})

    return make


def _spec(assets: RecordingAssets, asset: AnyAsset) -> dg.AssetSpec:
    return dg.AssetSpec(
        asset.name,
        # All but the inventory depend on the recording through the inventory, which has a digest of each topic: so a
        # recording that was only re-indexed or re-compressed leaves them fresh in Dagster's markers, too.
        deps=list(assets.upstream(asset.name)) or ["bag"],
        group_name=GROUP,
        kinds=set(asset.kinds),
        description=asset.about,
        code_version=assets.versions[asset.name],
        skippable=True,
    )


def _build(
    context: dg.AssetExecutionContext, workspace: Workspace, recording_lock: RecordingLock, wanted: set[str]
) -> Iterator[dg.MaterializeResult[None]]:
    key, assets = context.partition_key, workspace.assets
    recording_lock.take(context)
    record = recorded_partition(context.instance, "bag", key)
    if record is None or record.stat is None:
        raise StoreError(f"{key}: bag is not materialized for this recording; materialize bag first.")
    # The inventory decides whether the recording takes part, even if the asset (of a package) does not read it.
    upstream = {"inventory", *(name for asset in wanted for name in assets.upstream(asset))} - wanted
    given = {
        name: recorded_artifact(context.instance, workspace.store, name, key)
        for name in sorted(upstream)
        if recorded_partition(context.instance, name, key) is not None
    }
    graph = Graph(
        assets,
        workspace.store,
        workspace.recording(key),
        record.data_version,
        record.stat,
        wanted=wanted,
        given=given,
    )
    for result in execute(graph):
        if isinstance(result, Skipped):
            context.log.info("%s is skipped: %s.", key, visible(result.reason))
            return
        reason = graph.node(SELECTION).skipped if result.asset == "inventory" else None
        yield dg.MaterializeResult(
            asset_key=result.asset,
            data_version=dg.DataVersion(result.artifact.digest),
            metadata=result_metadata(result) | ({"skipped": reason} if reason else {}),
        )
