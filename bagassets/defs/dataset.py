"""The assets of the whole dataset: the small index of its inputs, and the dataset itself."""

import dagster as dg

from bagassets.defs.planning import plan_now
from bagassets.defs.reporting import dataset_metadata, failures_in_words
from bagassets.defs.workspace import Workspace
from bagassets.engine.dataset_build import (
    DatasetInputs,
    build_dataset,
    dataset_code_versions,
    is_on_disk,
)
from bagassets.recipe.model import Recipe

__all__ = ["DATASET_ASSETS", "current_inputs", "dataset_assets", "dataset_is_current", "record_inputs"]

GROUP = "dataset"
DATASET_ASSETS = ("dataset_inputs", "nuscenes_dataset")


def current_inputs(instance: dg.DagsterInstance, workspace: Workspace) -> DatasetInputs:
    """Return what the dataset would be made from now: live, current and selected recordings."""
    return plan_now(instance, workspace).inputs


def dataset_is_current(instance: dg.DagsterInstance, recipe: Recipe, inputs: DatasetInputs) -> bool:
    """Tell whether all datasets on disk were made from `inputs` by this recipe and code."""
    return all(
        _is_current(instance, recipe, inputs, asset, version)
        for asset, version in dataset_code_versions(recipe).items()
    )


def _is_current(
    instance: dg.DagsterInstance, recipe: Recipe, inputs: DatasetInputs, asset: str, version: str
) -> bool:
    latest = instance.get_latest_materialization_event(dg.AssetKey(asset))
    made = latest.asset_materialization if latest is not None else None
    if made is None:
        return not inputs.parts
    tags = made.tags or {}
    return (
        tags.get("dagster/input_data_version/dataset_inputs") == inputs.digest
        and tags.get("dagster/code_version") == version
        and is_on_disk(recipe, asset)
    )


def record_inputs(instance: dg.DagsterInstance, inputs: DatasetInputs) -> None:
    """Record `dataset_inputs` without a run (about 10 ms), if it changed.

    Its tags say what it was made from, as those of a run would: else Dagster's markers call it stale.
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
            metadata=dict(inputs.as_json()),
            tags={
                "dagster/data_version": inputs.digest,
                "dagster/code_version": "1",
                "dagster/input_data_version/nuscenes_tables": inputs.digest,
                "dagster/input_event_pointer/nuscenes_tables": str(_newest_tables(instance)),
            },
        )
    )


def _newest_tables(instance: dg.DagsterInstance) -> int:
    """Return the storage id of the newest `nuscenes_tables` of all recordings; Dagster looks for newer ones."""
    ids = instance.event_log_storage.get_latest_storage_id_by_partition(
        dg.AssetKey("nuscenes_tables"), dg.DagsterEventType.ASSET_MATERIALIZATION
    )
    return max(ids.values(), default=0)


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
        code_version=dataset_code_versions(recipe)["nuscenes_dataset"],
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
