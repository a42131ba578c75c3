"""The assets of the whole dataset: the small index of its inputs, and the dataset itself."""

import dagster as dg

from bagassets.defs.events import live_partitions, recorded_states
from bagassets.defs.reporting import dataset_metadata, failures_in_words
from bagassets.defs.workspace import Workspace
from bagassets.engine.dataset_build import DatasetInputs, build_dataset, dataset_code_version, select_inputs
from bagassets.engine.plan import make_plan
from bagassets.recipe.model import Recipe
from bagassets.steps.nuscenes_dataset import read_lock

__all__ = ["DATASET_ASSETS", "current_inputs", "dataset_assets", "dataset_is_current", "record_inputs"]

GROUP = "dataset"
DATASET_ASSETS = ("dataset_inputs", "nuscenes_dataset")


def current_inputs(instance: dg.DagsterInstance, workspace: Workspace) -> DatasetInputs:
    """Return what the dataset would be made from now: live, current and selected recordings."""
    recipe = workspace.recipe
    recorded = recorded_states(instance)
    live = live_partitions(instance, recipe)
    plan = make_plan(recipe, workspace.store, workspace.discover(), recorded, live, workspace.index)
    return select_inputs(plan, recorded, live)


def dataset_is_current(instance: dg.DagsterInstance, recipe: Recipe, inputs: DatasetInputs) -> bool:
    """Tell whether the dataset on disk was made from `inputs` by this recipe and code."""
    latest = instance.get_latest_materialization_event(dg.AssetKey("nuscenes_dataset"))
    made = latest.asset_materialization if latest is not None else None
    if made is None:
        return not inputs.parts
    tags = made.tags or {}
    return (
        tags.get("dagster/input_data_version/dataset_inputs") == inputs.digest
        and tags.get("dagster/code_version") == dataset_code_version(recipe)
        and read_lock(recipe.nuscenes.output, recipe.nuscenes.version) is not None
    )


def record_inputs(instance: dg.DagsterInstance, inputs: DatasetInputs) -> None:
    """Record `dataset_inputs` without a run (about 10 ms), if it changed."""
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
            metadata=dict(inputs.as_json()),
            tags={"dagster/data_version": inputs.digest, "dagster/code_version": "1"},
        )
    )


def dataset_assets(recipe: Recipe) -> list[dg.AssetsDefinition]:
    """Return the assets that exist once."""

    @dg.asset(
        name="dataset_inputs",
        deps=[dg.AssetDep("nuscenes_tables", partition_mapping=dg.AllPartitionMapping())],
        group_name=GROUP,
        kinds={"json"},
        description=(
            "Which recordings the dataset is made from. Its data version is a digest of their keys and versions, "
            "so that a change or a removal among any number of recordings is noticed."
        ),
        code_version="1",
    )
    def dataset_inputs(context: dg.AssetExecutionContext, workspace: Workspace) -> dg.MaterializeResult[None]:
        with failures_in_words():
            inputs = current_inputs(context.instance, workspace)
            return dg.MaterializeResult(
                data_version=dg.DataVersion(inputs.digest), metadata=dict(inputs.as_json())
            )

    @dg.asset(
        name="nuscenes_dataset",
        deps=["dataset_inputs"],
        group_name=GROUP,
        kinds={"nuscenes"},
        description="The nuScenes dataroot: samples, sweeps, maps and tables of all recordings, swapped in atomically.",
        code_version=dataset_code_version(recipe),
    )
    def nuscenes_dataset(
        context: dg.AssetExecutionContext, workspace: Workspace
    ) -> dg.MaterializeResult[None]:
        with failures_in_words():
            inputs = current_inputs(context.instance, workspace)
            made = build_dataset(workspace.recipe, workspace.store, inputs)
            return dg.MaterializeResult(
                data_version=dg.DataVersion(made.digest), metadata=dataset_metadata(made)
            )

    return [dataset_inputs, nuscenes_dataset]
