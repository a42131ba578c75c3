"""Reading a recipe file: YAML to `Recipe`, with the line of whatever is wrong."""

from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError

from bagassets.errors import RecipeError
from bagassets.recipe.model import Recipe


def load_recipe(path: Path | str) -> Recipe:
    """Return the recipe in `path`, its paths made absolute.

    Raises:
        RecipeError: the file is missing or wrong; the message names file, line and field.
    """
    path = Path(path).absolute()
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise RecipeError(
            f"{path}: no recipe here; make one with `bagassets init PROJECT --bags DIR`, or name one with --recipe."
        ) from None
    except (OSError, UnicodeDecodeError) as err:
        raise RecipeError(
            f"{path}: the recipe cannot be read ({err}); it must be a UTF-8 text file."
        ) from err
    return parse_recipe(text, path)


def parse_recipe(text: str, path: Path) -> Recipe:
    """Return the recipe in `text`, which was read from `path` (for messages and relative paths)."""
    try:
        node = yaml.compose(text, Loader=yaml.SafeLoader)
        data = yaml.safe_load(text)
    except yaml.YAMLError as err:
        mark = getattr(err, "problem_mark", None)
        where = f"{path}:{mark.line + 1}" if mark is not None else str(path)
        problem = getattr(err, "problem", None) or "not valid YAML"
        raise RecipeError(f"{where}: the recipe is not valid YAML ({problem}).") from err
    if not isinstance(data, dict):
        raise RecipeError(f"{path}: a recipe is a YAML mapping with the fields name, bags and rigs.")
    try:
        recipe = Recipe.model_validate(data)
    except ValidationError as err:
        raise RecipeError("\n".join(_sentence(problem, node, path) for problem in err.errors())) from err
    return _absolute(recipe, path.parent)


def _sentence(problem: Any, node: yaml.Node | None, path: Path) -> str:
    keys = [part for part in problem["loc"] if part not in {"camera", "lidar", "radar", "[key]"}]
    keys = [part for part in keys if part not in {"odometry", "pose", "tf", "navsat", "fixed"}]
    line = _line(node, problem["loc"])
    field = ".".join(str(part) for part in keys) or "recipe"
    text = problem["msg"].removeprefix("Value error, ")
    if problem["type"] == "extra_forbidden":
        text = "no such field; `bagassets docs recipe` lists all fields"
    elif problem["type"] == "missing":
        text = "this field is required"
    return f"{path}:{line}: {field}: {text}."


def _line(node: yaml.Node | None, location: tuple[str | int, ...]) -> int:
    """Line (from 1) of the deepest node on `location` that the file has."""
    line = 1
    for key in location:
        if isinstance(node, yaml.MappingNode):
            found = [(k, v) for k, v in node.value if k.value == str(key)]
            if not found:
                continue  # a tag of a union or a missing field: stay on the mapping
            line, node = found[0][0].start_mark.line + 1, found[0][1]
        elif isinstance(node, yaml.SequenceNode) and isinstance(key, int) and key < len(node.value):
            node = node.value[key]
            line = node.start_mark.line + 1
    return line


def _absolute(recipe: Recipe, folder: Path) -> Recipe:
    bags = recipe.bags.model_copy(
        update={
            "root": _resolve(folder, recipe.bags.root),
            "message_definitions": tuple(_resolve(folder, p) for p in recipe.bags.message_definitions),
        }
    )
    rigs = tuple(
        rig if rig.urdf is None else rig.model_copy(update={"urdf": _resolve(folder, rig.urdf)})
        for rig in recipe.rigs
    )
    nuscenes = recipe.nuscenes.model_copy(update={"output": _resolve(folder, recipe.nuscenes.output)})
    state = _resolve(folder, recipe.state)
    return recipe.model_copy(update={"bags": bags, "rigs": rigs, "nuscenes": nuscenes, "state": state})


def _resolve(folder: Path, path: Path) -> Path:
    return (folder / path.expanduser()).resolve()
