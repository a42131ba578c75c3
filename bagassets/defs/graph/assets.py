"""The assets of a recording as Dagster assets: `bag`, those extracted from it, and those made from these."""

from collections.abc import Iterator, Sequence

import dagster as dg
import pyarrow as pa

from bagassets.assets.asset import AnyAsset
from bagassets.base.alike import names_text
from bagassets.base.errors import StoreError
from bagassets.defs.graph.checks import check_recording
from bagassets.defs.graph.making import dependencies, make_recording, read_bag
from bagassets.defs.graph.several import make_batch
from bagassets.defs.records.naming import DATASET_INPUTS, Naming
from bagassets.defs.records.partitions import recording_partitions
from bagassets.defs.records.recorder import Recorder
from bagassets.defs.records.reporting import BAG_CODE_VERSION, code_link, errors_explained
from bagassets.defs.records.run_step import RunStep
from bagassets.defs.records.workspace import Workspace
from bagassets.defs.runs.exclusive import RecordingLock
from bagassets.engine.batches import DATASET
from bagassets.engine.execute import BuildFailure
from bagassets.engine.recording_assets import RecordingAssets
from bagassets.formats.catalogue import recording_assets
from bagassets.formats.dataset_build import dataset_code_versions
from bagassets.recipe.model import Recipe
from bagassets.recordings.model import RecordingFiles

_BAG = """A recording: a ROS 1 bag, a ROS 2 bag or an MCAP file.

Its data version is the digest of its content; each file is hashed once. Touching a file does not change it."""


def recording_definitions(
    recipe: Recipe, names: Naming, policy: dg.BackfillPolicy | None
) -> list[dg.AssetsDefinition]:
    """Return the assets that exist once per recording; with a `policy`, a backfill has runs about several of them."""
    assets = recording_assets(recipe)
    bag = dg.AssetSpec(
        names.key("bag"),
        group_name=names.recording_group,
        kinds={"ros", "file"},
        description=_BAG,
        code_version=BAG_CODE_VERSION,
        metadata=code_link(read_bag),
        skippable=True,
    )
    specs = {asset.name: _spec(assets, names, asset) for asset in assets}
    extracted = [spec for name, spec in specs.items() if name in assets.extracted]
    alone = [asset for asset in assets if asset.name not in assets.extracted]
    return [
        _definition(recipe, names, "bag", [bag], policy),
        _definition(recipe, names, "extract", extracted, policy, can_subset=True),
        *(
            _definition(recipe, names, one.face.operation or f"make_{one.name}", [specs[one.name]], policy)
            for one in alone
        ),
    ]


def _definition(
    recipe: Recipe,
    names: Naming,
    operation: str,
    specs: Sequence[dg.AssetSpec],
    policy: dg.BackfillPolicy | None,
    *,
    can_subset: bool = False,
) -> dg.AssetsDefinition:
    """Return the definition of an operation: of an asset alone, or of all that are extracted."""

    @dg.multi_asset(
        name=names.spell(operation),
        can_subset=can_subset,
        partitions_def=recording_partitions(recipe.bags, names),
        required_resource_keys={names.workspace, names.lock},
        backfill_policy=policy,
        specs=specs,
    )
    def make(context: dg.AssetExecutionContext) -> Iterator[dg.MaterializeResult[None]]:
        workspace = Workspace.of(context, names.workspace)
        lock: RecordingLock = getattr(context.resources, names.lock)
        selected = context.run.asset_selection
        own = {str(names.asset_of(one)) for one in context.selected_asset_keys}
        with errors_explained():
            wanted = [
                name
                for name in ("bag", *workspace.assets.names)
                if not selected or names.key(name) in selected
            ]
            if context.has_partition_key_range:
                _make_range(context, workspace, lock, wanted)
                return
            key = context.partition_key
            recorder = Recorder(workspace, key, context, wanted)
            with recorder.giving_up(own):
                lock.take(context)
                recording = workspace.recording(key)
                try:
                    for made in make_recording(recorder, recording, own):
                        yield from recorder.record(made)
                except BuildFailure as err:
                    _make_not_begun(recorder, recording, own, err)
                    raise

    return make


def _make_range(
    context: dg.AssetExecutionContext, workspace: Workspace, lock: RecordingLock, wanted: Sequence[str]
) -> None:
    """Make all that a run about several recordings is to make of them, in the first of its steps.

    It yields nothing, so Dagster skips the steps that read it: of the results of a step it would record that all these
    recordings have them, with the same version.
    """
    this = object()
    if workspace.once_in_run(context.run.run_id, lambda: this) is not this:
        return
    names, datasets = workspace.names, dataset_code_versions(workspace.recipe)
    ours = {names.key(name) for name in (*wanted, DATASET_INPUTS, *datasets)}
    selected = context.run.asset_selection or ours
    if others := sorted(key.to_user_string() for key in selected - ours):
        raise StoreError(
            f"{names_text(others)}: the backfill policy is that of bagassets, so Dagster puts them into the same run, which "
            "makes nothing else; choose another, or none."
        )
    batch: dict[str, Sequence[str]] = dict.fromkeys(context.partition_keys, wanted)
    if chosen := [name for name in datasets if names.key(name) in selected]:
        batch[DATASET] = chosen
    make_batch(RunStep.of(context, is_planned=True), workspace, lock, batch, side_by_side=True)


def _make_not_begun(recorder: Recorder, recording: RecordingFiles, own: set[str], err: BuildFailure) -> None:
    """Make the assets of a run that Dagster does not begin after a step that failed, though they do not read what failed.

    Raises:
        BagAssetsError: some could not be made.
    """
    assets, missing = recorder.workspace.assets, own - recorder.made
    rest = [
        name
        for name in recorder.wanted
        if name not in {"bag", *assets.extracted} and missing.isdisjoint(assets.with_upstream([name]))
    ]
    if not rest or own.isdisjoint(assets.extracted):
        return
    try:
        for made in make_recording(recorder, recording, rest):
            recorder.record(made)
        recorder.record_checks(check_recording(recorder, recording, rest))
    except BuildFailure as more:
        raise BuildFailure({**err.errors, **more.errors}, recording.path) from None


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
        skippable=True,
    )


def _columns(schema: pa.Schema) -> dict[str, dg.TableSchemaMetadataValue]:
    """Return the columns of a table as the web UI shows them; said once, not with each materialization."""
    columns = [dg.TableColumn(field.name, _type_name(field.type)) for field in schema]
    return {"dagster/column_schema": dg.MetadataValue.table_schema(dg.TableSchema(columns))}


def _type_name(kind: pa.DataType) -> str:
    """Return the name of a type; what files call the items of a list is of no interest."""
    return f"list<{kind.value_type}>" if pa.types.is_list(kind) else str(kind)
