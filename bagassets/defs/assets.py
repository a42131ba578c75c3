"""The assets of a recording as Dagster assets: `bag`, those extracted from it, and those made from these."""

from collections.abc import Iterator

import dagster as dg
import pyarrow as pa

from bagassets.annotations.table import SCHEMA as BOX_SCHEMA
from bagassets.assets.asset import AnyAsset
from bagassets.build.execute import Skipped
from bagassets.build.recording_assets import RecordingAssets
from bagassets.defs.exclusive import RecordingLock
from bagassets.defs.making import dependencies, make_assets, read_bag, recorded_bag
from bagassets.defs.not_made import failures_observed
from bagassets.defs.partitions import recording_partitions
from bagassets.defs.reporting import BAG_CODE_VERSION, errors_explained
from bagassets.defs.workspace import Workspace
from bagassets.escaping import visible
from bagassets.formats.catalogue import recording_assets
from bagassets.recipe.model import Recipe

__all__ = ["recording_definitions"]

GROUP = "recording"
_BAG = """A recording: a ROS 1 bag, a ROS 2 bag or an MCAP file.

Its data version is the digest of its content; each file is hashed once. Touching a file does not change it."""
# Operations of assets that are not called `make_<asset>` in the runs on record.
_OPERATIONS = {"nuscenes_tables": "tables"}
# Assets that are one table of columns that are known beforehand.
_SCHEMAS = {"annotations": BOX_SCHEMA}


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
        with errors_explained(), failures_observed(context, assets, {"bag"}):
            recording_lock.take(context)
            selected = context.run.asset_selection
            _, made = read_bag(
                context.instance,
                workspace,
                workspace.recording(context.partition_key),
                context.run.run_id,
                makes_inventory=selected is None or dg.AssetKey("inventory") in selected,
            )
            recording_lock.check()
            return dg.MaterializeResult(
                data_version=dg.DataVersion(made.data_version), metadata=made.metadata
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
        deps=dependencies(assets, asset.name),
        group_name=GROUP,
        kinds=set(asset.kinds),
        description=asset.about,
        code_version=assets.versions[asset.name],
        metadata=_columns(_SCHEMAS[asset.name]) if asset.name in _SCHEMAS else None,
        skippable=True,
    )


def _columns(schema: pa.Schema) -> dict[str, dg.TableSchemaMetadataValue]:
    """Return the columns of a table as the web UI shows them; said once, not with each materialization."""
    columns = [dg.TableColumn(field.name, _type_name(field.type)) for field in schema]
    return {"dagster/column_schema": dg.MetadataValue.table_schema(dg.TableSchema(columns))}


def _type_name(kind: pa.DataType) -> str:
    """Return the name of a type; what files call the items of a list is of no interest."""
    return f"list<{kind.value_type}>" if pa.types.is_list(kind) else str(kind)


def _build(
    context: dg.AssetExecutionContext, workspace: Workspace, recording_lock: RecordingLock, wanted: set[str]
) -> Iterator[dg.MaterializeResult[None]]:
    key = context.partition_key
    with failures_observed(context, workspace.assets, wanted) as done:
        recording_lock.take(context)
        source = recorded_bag(context.instance, workspace.recording(key))
        for made in make_assets(context.instance, workspace, source, wanted, context.run.run_id):
            if isinstance(made, Skipped):
                context.log.info("%s is skipped: %s.", key, visible(made.reason))
                continue
            recording_lock.check()
            # Not in the result, where it would be recorded twice: with the output of the step, too.
            context.add_asset_metadata(made.metadata, asset_key=made.asset, partition_key=key)
            yield dg.MaterializeResult(asset_key=made.asset, data_version=dg.DataVersion(made.data_version))
            done.add(made.asset)
