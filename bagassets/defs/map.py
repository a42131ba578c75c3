"""The asset `trajectory_map`: all recordings on one interactive map."""

import dagster as dg

from bagassets.defs.planning import plan_of_run
from bagassets.defs.reporting import failures_in_words
from bagassets.defs.workspace import Workspace
from bagassets.formats.dataset_build import dataset_code_versions
from bagassets.formats.report_data import build_map, map_path
from bagassets.recipe.model import Recipe

__all__ = ["map_asset"]


def map_asset(recipe: Recipe) -> dg.AssetsDefinition:
    """Return the asset; the recipe asks for the map."""

    @dg.asset(
        name="trajectory_map",
        deps=["dataset_inputs"],
        group_name="dataset",
        kinds={"html"},
        description=(
            "Where all recordings were driven: an interactive map with a layer per split and a heat layer. Without "
            "network it shows the same ways on a plain grid."
        ),
        code_version=dataset_code_versions(recipe)["trajectory_map"],
    )
    def trajectory_map(context: dg.AssetExecutionContext, workspace: Workspace) -> dg.MaterializeResult[None]:
        with failures_in_words():
            plan = plan_of_run(context, workspace).plan
            made = build_map(workspace.recipe, workspace.store, plan)
            return dg.MaterializeResult(
                data_version=dg.DataVersion(made.artifact.digest),
                metadata={
                    "map": dg.MetadataValue.path(str(map_path(workspace.recipe))),
                    "cached": made.cached,
                    **made.artifact.summary(),
                },
            )

    return trajectory_map
