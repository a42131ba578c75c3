"""A project as a Dagster component: a `defs.yaml` in a code location that has others.

For example::

    type: bagassets.RecordingDatasets
    attributes:
      recipe: recipe.yaml
      key_prefix: north

`dg scaffold defs bagassets.RecordingDatasets NAME --recipe FILE` writes one.
"""

import json
from pathlib import Path
from typing import Any

import dagster as dg
from pydantic import BaseModel, Field

from bagassets.base.errors import RecipeError
from bagassets.defs.graph.location import build_definitions
from bagassets.recipe.inline import parse_inline, write_inline

__all__ = ["RecordingDatasets"]


class ScaffoldParams(BaseModel):
    """What `dg scaffold` asks for."""

    recipe: str = Field(
        default="recipe.yaml", description="The recipe, relative to the folder of the component."
    )
    key_prefix: str | None = Field(
        default=None, description="Stands before the name of each asset in its key."
    )


class RecordingDatasetsScaffolder(dg.Scaffolder[ScaffoldParams]):
    """Writes the `defs.yaml` of a project."""

    @classmethod
    def get_scaffold_params(cls) -> type[ScaffoldParams]:
        """Return what can be said on the command line."""
        return ScaffoldParams

    def scaffold(self, request: dg.ScaffoldRequest[ScaffoldParams]) -> None:
        """Write the file."""
        dg.scaffold_component(request, request.params.model_dump(exclude_none=True))


@dg.scaffold_with(RecordingDatasetsScaffolder)
class RecordingDatasets(dg.Component, dg.Resolvable, dg.Model):
    """Datasets made from robot recordings: the assets, checks and the sensor of a recipe.

    Attributes:
        recipe: path of the recipe, relative to the folder of the component; or the recipe itself, with paths relative to
            that folder.
        key_prefix: stands before the name of each asset in its key; several parts as a list.
        group_name: group of all assets.
        resource_key: key of the `Workspace` resource, which your own assets ask for.
        in_process: the definitions name `in_process_executor`; default: only without a prefix.
    """

    recipe: str | dict[str, Any] | None = None
    key_prefix: str | list[str] | None = None
    group_name: str | None = None
    resource_key: str | None = None
    in_process: bool | None = None

    def build_defs(self, context: dg.ComponentLoadContext) -> dg.Definitions:
        """Return the definitions of the recipe.

        Raises:
            RecipeError: there is none, or it is wrong.
            StoreError: a recipe in the YAML of the component cannot be written into its state folder.
        """
        try:
            recipe_file = self._recipe_file(context.path)
            return build_definitions(recipe_file, **self.model_dump(exclude={"recipe"}))
        except RecipeError as err:
            # Dagster prints the trace of each cause, as that of a YAML parser; the sentence says it all.
            raise RecipeError(str(err)) from None

    def _recipe_file(self, place: Path) -> Path:
        folder = place if place.is_dir() else place.parent
        file = folder / "defs.yaml"
        if not self.recipe:
            raise RecipeError(
                f"{file}: attributes.recipe is missing; expected the path of a recipe, or the recipe itself (`bagassets init` "
                "makes one for a folder of recordings)."
            )
        if isinstance(self.recipe, str):
            return folder / self.recipe
        recipe = parse_inline(json.dumps(self.recipe), file)
        return write_inline(recipe, recipe.state, recipe.store)
