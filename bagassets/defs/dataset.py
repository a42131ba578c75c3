"""The assets of the whole dataset: the small index of its inputs, and the dataset itself."""

import dagster as dg

from bagassets.defs.planning import plan_of_run
from bagassets.defs.reporting import dataset_metadata, failures_in_words, inputs_metadata
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
from bagassets.recipe.model import Recipe

__all__ = ["dataset_assets", "dataset_is_current", "record_inputs"]

GROUP = "dataset"
INPUTS_CODE_VERSION = "1"

_INPUTS = """Which recordings the datasets are made from, and why others are left out.

Its data version is a digest over the partition keys and data versions of all recordings that take part. A change or a
removal among any number of them shows here, where Dagster itself looks at no more than 100 partitions. The sensor and
`bagassets build` record it without a run."""


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
        return not any(inputs.parts.values())
    tags = made.tags or {}
    return (
        tags.get("dagster/input_data_version/dataset_inputs") == inputs.digest
        and tags.get("dagster/code_version") == version
        and is_on_disk(recipe, asset)
    )


def record_inputs(instance: dg.DagsterInstance, recipe: Recipe, inputs: DatasetInputs) -> None:
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
            metadata=inputs_metadata(inputs),
            tags={
                "dagster/data_version": inputs.digest,
                "dagster/code_version": INPUTS_CODE_VERSION,
                **_provenance(instance, recipe, inputs),
            },
        )
    )


def _provenance(instance: dg.DagsterInstance, recipe: Recipe, inputs: DatasetInputs) -> dict[str, str]:
    """Return tags that name the newest record of all recordings; Dagster looks for newer ones."""
    tags = {}
    for asset in _read_of_recordings(recipe):
        ids = instance.event_log_storage.get_latest_storage_id_by_partition(
            dg.AssetKey(asset), dg.DagsterEventType.ASSET_MATERIALIZATION
        )
        tags[f"dagster/input_data_version/{asset}"] = inputs.digest
        tags[f"dagster/input_event_pointer/{asset}"] = str(max(ids.values(), default=0))
    return tags


def _read_of_recordings(recipe: Recipe) -> list[str]:
    """Return the assets of a recording that the datasets are made from."""
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
        with failures_in_words():
            inputs = plan_of_run(context, workspace).inputs
            return dg.MaterializeResult(
                data_version=dg.DataVersion(inputs.digest), metadata=inputs_metadata(inputs)
            )

    return [dataset_inputs, *(_dataset_asset(recipe, dataset) for dataset in datasets_of(recipe).values())]


def _dataset_asset(recipe: Recipe, dataset: Dataset) -> dg.AssetsDefinition:
    @dg.asset(
        name=dataset.asset,
        deps=["dataset_inputs"],
        group_name=GROUP,
        kinds=set(dataset.kind.kinds),
        description=dataset.description,
        code_version=dataset_code_versions(recipe)[dataset.asset],
    )
    def build(context: dg.AssetExecutionContext, workspace: Workspace) -> dg.MaterializeResult[None]:
        with failures_in_words():
            planned = plan_of_run(context, workspace)
            # The recipe as it is now: this process may be older.
            now = datasets_of(workspace.recipe)[dataset.asset]
            made = build_dataset(now, workspace.recipe, workspace.store, planned.plan, planned.inputs)
            failed = planned.inputs.failed.get(dataset.kind.name, {})
            return dg.MaterializeResult(
                data_version=dg.DataVersion(made.digest), metadata=dataset_metadata(made, failed)
            )

    return build
