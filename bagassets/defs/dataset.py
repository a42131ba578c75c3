"""The assets that exist once: the index of inputs, the datasets made from it, and the map."""

import dagster as dg

from bagassets.defs.artifact_files import page_link
from bagassets.defs.fence import refuse_if_ended
from bagassets.defs.instance_plan import InstancePlan, plan_in_run
from bagassets.defs.making import MadeAsset
from bagassets.defs.reporting import dataset_metadata, errors_explained, inputs_metadata
from bagassets.defs.workspace import Workspace
from bagassets.formats.catalogue import formats, recording_assets
from bagassets.formats.dataset_build import (
    Dataset,
    DatasetInputs,
    build_dataset,
    dataset_code_versions,
    datasets_of,
    is_on_disk,
)
from bagassets.formats.report_data import build_map, map_path
from bagassets.recipe.model import Recipe

__all__ = ["dataset_assets", "dataset_is_current", "make_dataset", "record_inputs"]

GROUP = "dataset"
TRAJECTORY_MAP = "trajectory_map"
INPUTS_CODE_VERSION = "1"

_INPUTS = """Which recordings the datasets are made from, and why others are left out.

Its data version is a digest over the partition keys and data versions of all recordings that take part, so it changes
with each of them and when one is removed, however many there are; Dagster itself compares at most 100 partitions. The
sensor and `bagassets build` record it without a run."""
_MAP = """Where all recordings were driven: an interactive map with a layer per split and a heat layer.

Without a network, it shows the same routes on a plain grid."""


def dataset_is_current(instance: dg.DagsterInstance, recipe: Recipe, inputs: DatasetInputs) -> bool:
    """Return whether all datasets on disk were made from `inputs` with this recipe and code."""
    return all(
        _is_current(instance, recipe, inputs, asset, version)
        for asset, version in dataset_code_versions(recipe).items()
    )


def _is_current(
    instance: dg.DagsterInstance, recipe: Recipe, inputs: DatasetInputs, asset: str, version: str
) -> bool:
    latest = instance.get_latest_materialization_event(dg.AssetKey(asset))
    materialization = latest.asset_materialization if latest is not None else None
    if materialization is None:
        return not any(inputs.parts.values())
    tags = materialization.tags or {}
    return (
        tags.get("dagster/input_data_version/dataset_inputs") == inputs.digest
        and tags.get("dagster/code_version") == version
        and is_on_disk(recipe, asset)
    )


def record_inputs(instance: dg.DagsterInstance, recipe: Recipe, inputs: DatasetInputs) -> None:
    """Record `dataset_inputs` without a run (about 10 ms), if it changed.

    Its tags name its inputs, as those of a run would: without them Dagster would mark it as stale.
    """
    latest = instance.get_latest_materialization_event(dg.AssetKey("dataset_inputs"))
    materialization = latest.asset_materialization if latest is not None else None
    recorded = (
        (materialization.tags or {}).get("dagster/data_version") if materialization is not None else None
    )
    if recorded == inputs.digest:
        return
    instance.report_runless_asset_event(
        dg.AssetMaterialization(
            asset_key="dataset_inputs",
            metadata=inputs_metadata(inputs),
            tags={
                "dagster/data_version": inputs.digest,
                "dagster/code_version": INPUTS_CODE_VERSION,
                **_provenance(instance, recipe, inputs),
            },
        )
    )


def _provenance(instance: dg.DagsterInstance, recipe: Recipe, inputs: DatasetInputs) -> dict[str, str]:
    """Return tags that point to the newest record of all recordings, which Dagster compares with later ones."""
    tags = {}
    for asset in _read_of_recordings(recipe):
        ids = instance.event_log_storage.get_latest_storage_id_by_partition(
            dg.AssetKey(asset), dg.DagsterEventType.ASSET_MATERIALIZATION
        )
        tags[f"dagster/input_data_version/{asset}"] = inputs.digest
        tags[f"dagster/input_event_pointer/{asset}"] = str(max(ids.values(), default=0))
    return tags


def _read_of_recordings(recipe: Recipe) -> list[str]:
    """Return the assets of a recording that datasets are made from."""
    return [kind.part for kind in formats() if kind.part in recording_assets(recipe).names]


def dataset_assets(recipe: Recipe) -> list[dg.AssetsDefinition]:
    """Return the assets that exist once."""

    @dg.asset(
        name="dataset_inputs",
        deps=[
            dg.AssetDep(asset, partition_mapping=dg.AllPartitionMapping())
            for asset in _read_of_recordings(recipe)
        ],
        group_name=GROUP,
        kinds={"json"},
        description=_INPUTS,
        code_version=INPUTS_CODE_VERSION,
    )
    def dataset_inputs(context: dg.AssetExecutionContext, workspace: Workspace) -> dg.MaterializeResult[None]:
        with errors_explained():
            inputs = plan_in_run(context, workspace).inputs
            return dg.MaterializeResult(
                data_version=dg.DataVersion(inputs.digest), metadata=inputs_metadata(inputs)
            )

    datasets = [_dataset_asset(recipe, dataset) for dataset in datasets_of(recipe).values()]
    has_map = TRAJECTORY_MAP in dataset_code_versions(recipe)
    return [dataset_inputs, *datasets, *([_map_asset(recipe)] if has_map else [])]


def _dataset_asset(recipe: Recipe, dataset: Dataset) -> dg.AssetsDefinition:
    @dg.asset(
        name=dataset.asset,
        deps=["dataset_inputs"],
        group_name=GROUP,
        kinds=set(dataset.kind.kinds),
        description=dataset.description,
        code_version=dataset_code_versions(recipe)[dataset.asset],
    )
    def make(context: dg.AssetExecutionContext, workspace: Workspace) -> dg.MaterializeResult[None]:
        return _result(context, workspace, dataset.asset)

    return make


def _map_asset(recipe: Recipe) -> dg.AssetsDefinition:
    @dg.asset(
        name=TRAJECTORY_MAP,
        deps=["dataset_inputs"],
        group_name=GROUP,
        kinds={"html"},
        description=_MAP,
        code_version=dataset_code_versions(recipe)[TRAJECTORY_MAP],
    )
    def trajectory_map(context: dg.AssetExecutionContext, workspace: Workspace) -> dg.MaterializeResult[None]:
        return _result(context, workspace, TRAJECTORY_MAP)

    return trajectory_map


def _result(
    context: dg.AssetExecutionContext, workspace: Workspace, asset: str
) -> dg.MaterializeResult[None]:
    with errors_explained():
        planned = plan_in_run(context, workspace)
        made = make_dataset(context.instance, workspace, planned, asset, context.run.run_id)
        return dg.MaterializeResult(data_version=dg.DataVersion(made.data_version), metadata=made.metadata)


def make_dataset(
    instance: dg.DagsterInstance, workspace: Workspace, planned: InstancePlan, asset: str, run_id: str
) -> MadeAsset:
    """Make a dataset, or the map, from what is planned, and return what is to be recorded of it.

    Raises:
        BagAssetsError: it could not be made.
        RunEndedError: the run was given up meanwhile.
    """
    recipe = workspace.recipe  # as it is now: this process may be older

    def permit() -> None:
        refuse_if_ended(instance, run_id)

    if asset == TRAJECTORY_MAP:
        permit()
        outcome = build_map(recipe, workspace.store, planned.plan)
        return MadeAsset(
            asset,
            outcome.artifact.digest,
            {
                "open": dg.MetadataValue.md(f"[Open the map]({page_link('map')})"),
                "map": dg.MetadataValue.path(str(map_path(recipe))),
                "cached": outcome.cached,
                **outcome.artifact.summary(),
            },
        )
    dataset = datasets_of(recipe)[asset]
    summary = build_dataset(dataset, recipe, workspace.store, planned.plan, planned.inputs, permit)
    failed = planned.inputs.failed.get(dataset.kind.name, {})
    return MadeAsset(asset, summary.digest, dataset_metadata(summary, failed))
