"""One asset for each named dataset of the recipe."""

import dagster as dg

from bagassets.defs.planning import plan_now
from bagassets.defs.reporting import dataset_metadata, failures_in_words
from bagassets.defs.workspace import Workspace
from bagassets.engine.dataset_build import dataset_code_versions
from bagassets.engine.named_datasets import build_named_dataset
from bagassets.recipe.model import Recipe
from bagassets.recipe.model_datasets import NamedDataset

__all__ = ["named_dataset_asset"]


def named_dataset_asset(recipe: Recipe, wanted: NamedDataset) -> dg.AssetsDefinition:
    """Return the asset of a named dataset."""

    @dg.asset(
        name=wanted.asset,
        deps=["dataset_inputs"],
        group_name="dataset",
        kinds={"nuscenes"},
        description=f"The scenes that the recipe selects for dataset {wanted.name}: links and tables, nothing decoded again.",
        code_version=dataset_code_versions(recipe)[wanted.asset],
    )
    def named_dataset(context: dg.AssetExecutionContext, workspace: Workspace) -> dg.MaterializeResult[None]:
        with failures_in_words():
            planned = plan_now(context.instance, workspace)
            made, chosen = build_named_dataset(
                workspace.recipe, workspace.store, planned.plan, planned.inputs, wanted
            )
            left_out = dg.MetadataValue.json(dict(chosen.left_out))
            return dg.MaterializeResult(
                data_version=dg.DataVersion(made.digest),
                metadata=dataset_metadata(made) | {"scenes_left_out": left_out},
            )

    return named_dataset
