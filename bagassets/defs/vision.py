"""The assets of the vision dataset: each recording's sequences, and all of them together."""

from collections.abc import Mapping
from typing import Any

import dagster as dg

from bagassets.defs.dataset import current_inputs
from bagassets.defs.reporting import failures_in_words, moved_table, split_table
from bagassets.defs.workspace import Workspace
from bagassets.engine.dataset_build import build_vision_dataset, dataset_code_versions
from bagassets.recipe.model import Recipe
from bagassets.steps.vision_dataset import VisionSummary

__all__ = ["vision_dataset_asset"]


def vision_dataset_asset(recipe: Recipe) -> dg.AssetsDefinition:
    """Return the asset `vision_dataset`; the recipe has a `vision` section."""

    @dg.asset(
        name="vision_dataset",
        deps=["dataset_inputs"],
        group_name="dataset",
        kinds={"image", "json"},
        description=(
            "The vision dataset: image sequences in plain folders, merged annotation files and a manifest for each "
            "split, swapped in atomically."
        ),
        code_version=dataset_code_versions(recipe)["vision_dataset"],
    )
    def vision_dataset(context: dg.AssetExecutionContext, workspace: Workspace) -> dg.MaterializeResult[None]:
        with failures_in_words():
            inputs = current_inputs(context.instance, workspace)
            made = build_vision_dataset(workspace.recipe, workspace.store, inputs)
            return dg.MaterializeResult(
                data_version=dg.DataVersion(made.digest), metadata=_metadata(made, inputs.vision_failed)
            )

    return vision_dataset


def _metadata(made: VisionSummary, failed: Mapping[str, str]) -> dict[str, Any]:
    return {
        "folder": dg.MetadataValue.path(str(made.folder)),
        "recordings": sum(share.recordings for share in made.shares),
        "sequences": dg.MetadataValue.json(dict(made.sequences)),
        "images": dg.MetadataValue.json(dict(made.images)),
        "split_shares": dg.MetadataValue.md(split_table(made.shares)),
        "moved": dg.MetadataValue.md(moved_table(made.moved)),
        "files": dg.MetadataValue.json(dict(made.files)),
        "duplicates": dg.MetadataValue.json(dict(made.duplicates)),
        "failed": dg.MetadataValue.json(dict(failed)),
    }
