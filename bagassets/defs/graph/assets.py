"""The assets of a recording as Dagster assets: `bag`, those extracted from it, and those made from these."""

from collections.abc import Collection, Iterator

import dagster as dg
import pyarrow as pa

from bagassets.assets.asset import AnyAsset
from bagassets.assets.inventory import INVENTORY
from bagassets.defs.graph.batch_job import make_not_begun
from bagassets.defs.graph.making import dependencies, make_assets, read_bag, recorded_bag
from bagassets.defs.records.naming import Naming
from bagassets.defs.records.not_made import failures_observed, is_selected
from bagassets.defs.records.partitions import recording_partitions
from bagassets.defs.records.reporting import BAG_CODE_VERSION, code_link, errors_explained
from bagassets.defs.records.workspace import Workspace
from bagassets.defs.runs.exclusive import RecordingLock
from bagassets.engine.execute import BuildFailure
from bagassets.engine.recording_assets import RecordingAssets
from bagassets.formats.catalogue import recording_assets
from bagassets.recipe.model import Recipe

__all__ = ["recording_definitions"]

_BAG = """A recording: a ROS 1 bag, a ROS 2 bag or an MCAP file.

Its data version is the digest of its content; each file is hashed once. Touching a file does not change it."""


def recording_definitions(recipe: Recipe, names: Naming) -> list[dg.AssetsDefinition]:
    """Return the assets that exist once per recording."""
    assets = recording_assets(recipe)

    @dg.asset(
        key=names.key("bag"),
        partitions_def=recording_partitions(recipe.bags, names),
        required_resource_keys={names.workspace, names.lock},
        group_name=names.recording_group,
        kinds={"ros", "file"},
        description=_BAG,
        code_version=BAG_CODE_VERSION,
        metadata=code_link(read_bag),
    )
    def bag(context: dg.AssetExecutionContext) -> dg.MaterializeResult[None]:
        workspace, recording_lock = _resources(context, names)
        with errors_explained(), failures_observed(context, assets, names, {"bag"}):
            recording_lock.take(context)
            _, made = read_bag(
                context.instance,
                workspace,
                workspace.recording(context.partition_key),
                context.run.run_id,
                makes_inventory=is_selected(context, names.key(INVENTORY.name)),
            )
            recording_lock.check()
            return dg.MaterializeResult(
                data_version=dg.DataVersion(made.data_version), metadata=made.metadata
            )

    alone = [asset for asset in assets if asset.name not in assets.extracted]
    return [
        bag,
        _definition(assets, names, "extract", assets.extracted, can_subset=True),
        *(_definition(assets, names, one.face.operation or f"make_{one.name}", [one.name]) for one in alone),
    ]


def _definition(
    assets: RecordingAssets,
    names: Naming,
    operation: str,
    made: Collection[str],
    *,
    can_subset: bool = False,
) -> dg.AssetsDefinition:
    """Return the definition of an operation: of an asset alone, or of all that are extracted."""

    @dg.multi_asset(
        name=names.spell(operation),
        can_subset=can_subset,
        partitions_def=recording_partitions(assets.recipe.bags, names),
        required_resource_keys={names.workspace, names.lock},
        specs=[_spec(assets, names, asset) for asset in assets if asset.name in made],
    )
    def make(context: dg.AssetExecutionContext) -> Iterator[dg.MaterializeResult[None]]:
        selected = context.selected_asset_keys
        with errors_explained():
            yield from _build(context, names, {name for name in made if names.key(name) in selected})

    return make


def _spec(assets: RecordingAssets, names: Naming, asset: AnyAsset) -> dg.AssetSpec:
    return dg.AssetSpec(
        names.key(asset.name),
        deps=[names.key(name) for name in dependencies(assets, asset.name)],
        group_name=names.recording_group,
        kinds=set(asset.kinds),
        description=asset.about,
        code_version=assets.versions[asset.name],
        metadata={
            **({} if asset.face.columns is None else _columns(asset.face.columns)),
            **code_link(asset.make or asset.use),
        },
    )


def _columns(schema: pa.Schema) -> dict[str, dg.TableSchemaMetadataValue]:
    """Return the columns of a table as the web UI shows them; said once, not with each materialization."""
    columns = [dg.TableColumn(field.name, _type_name(field.type)) for field in schema]
    return {"dagster/column_schema": dg.MetadataValue.table_schema(dg.TableSchema(columns))}


def _type_name(kind: pa.DataType) -> str:
    """Return the name of a type; what files call the items of a list is of no interest."""
    return f"list<{kind.value_type}>" if pa.types.is_list(kind) else str(kind)


def _resources(context: dg.AssetExecutionContext, names: Naming) -> tuple[Workspace, RecordingLock]:
    return getattr(context.resources, names.workspace), getattr(context.resources, names.lock)


def _build(
    context: dg.AssetExecutionContext, names: Naming, wanted: set[str]
) -> Iterator[dg.MaterializeResult[None]]:
    key, (workspace, recording_lock) = context.partition_key, _resources(context, names)
    with failures_observed(context, workspace.assets, names, wanted) as done:
        recording_lock.take(context)
        source = recorded_bag(context.instance, names, workspace.recording(key), context.run.run_id)
        try:
            for made in make_assets(context.instance, workspace, source, wanted, context.run.run_id):
                recording_lock.check()
                # Not in the result, where it would be recorded twice: with the output of the step, too.
                asset = names.key(made.asset)
                context.add_asset_metadata(made.metadata, asset_key=asset, partition_key=key)
                yield dg.MaterializeResult(asset_key=asset, data_version=dg.DataVersion(made.data_version))
                done.add(made.asset)
        except BuildFailure as err:
            try:
                if rest := _not_begun(context, workspace, names, wanted, wanted - done):
                    make_not_begun(context, workspace, source, rest, recording_lock)
            except BuildFailure as more:
                raise BuildFailure({**err.errors, **more.errors}, source.recording.path) from None
            raise


def _not_begun(
    context: dg.AssetExecutionContext,
    workspace: Workspace,
    names: Naming,
    wanted: set[str],
    missing: set[str],
) -> list[str]:
    """Return the assets of the run after those extracted that read nothing that is missing."""
    assets = workspace.assets
    if wanted.isdisjoint(assets.extracted):
        return []
    return [
        name
        for name in assets.names
        if name not in assets.extracted
        and is_selected(context, names.key(name))
        and missing.isdisjoint(assets.with_upstream([name]))
    ]
