"""A recipe without a file of its own: given in Python, or as part of another file."""

import json
from pathlib import Path

from bagassets.base.errors import RecipeError, StoreError
from bagassets.base.files import write_atomically
from bagassets.base.json_types import JsonObject
from bagassets.recipe.load import parse_recipe
from bagassets.recipe.model import Recipe


def parse_inline(text: str, place: Path) -> Recipe:
    """Return the recipe in a text, with absolute paths.

    Args:
        text: the recipe.
        place: what errors call the file; paths are relative to its folder.

    Raises:
        RecipeError: the recipe is wrong, or leaves something to be decided.
    """
    recipe = parse_recipe(text, place)
    for rig in recipe.rigs:
        if rig.questions:  # what is to be decided has stand-ins, which would be written
            raise RecipeError(*rig.questions)
    return recipe


def write_inline(recipe: Recipe, state: Path, store: Path | None) -> Path:
    """Write a recipe into its state folder, where a build finds it, and return the file.

    Args:
        recipe: with absolute paths.
        state: its state folder.
        store: its store; None: in the state folder.

    Raises:
        StoreError: the file cannot be written.
    """
    own: JsonObject = recipe.model_dump(mode="json", exclude_unset=True)  # with absolute paths; JSON is YAML
    own |= {"state": str(state)} | ({} if store is None else {"store": str(store)})
    file, content = state / "recipe.yaml", json.dumps(own, ensure_ascii=False, indent=1).encode()
    # Written anew, it would have to be examined again.
    if not file.is_file() or file.read_bytes() != content:
        try:
            write_atomically(file, content, folders=True)
        except OSError as err:
            raise StoreError(f"{file}: the recipe cannot be written here ({err.strerror or err}).") from err
    return file
