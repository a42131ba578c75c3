"""Reading a recipe file into a `Recipe`; errors name their lines.

The result depends only on the text and the recipe's folder, not on environment variables, home or current folder.
"""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import cast

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from bagassets.base.errors import PluginError, RecipeError
from bagassets.base.json_types import Json, JsonMapping, JsonObject
from bagassets.base.plugins import FORMATS, installed_extensions
from bagassets.recipe.consistency import paths_in, problems_in
from bagassets.recipe.format_settings import OUR_FORMATS, asked_formats, section_model
from bagassets.recipe.model import Recipe
from bagassets.recipe.model_base import DatasetSettings
from bagassets.recipe.model_datasets import NamedDataset
from bagassets.recipe.problems import Problem, explain_all, open_questions, undecided, with_stand_ins
from bagassets.recipe.schema import closest
from bagassets.recipe.yaml_text import Place, read_yaml


def load_recipe(path: Path | str) -> Recipe:
    """Return the recipe in `path`, its paths made absolute.

    Raises:
        RecipeError: the file is missing or wrong; each line of the message names file, line and field.
    """
    path = Path(path).absolute()
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise RecipeError(
            f"{path}: no recipe here; make one with `bagassets init PROJECT --bags DIR`, or name one with --recipe."
        ) from None
    except IsADirectoryError:
        raise RecipeError(
            f"{path}: this is a folder; name the recipe file in it, usually {path / 'recipe.yaml'}."
        ) from None
    except UnicodeDecodeError as err:
        line = err.object[: err.start].count(b"\n") + 1
        raise RecipeError(
            f"{path}:{line}: the recipe is not UTF-8 text; save it with that encoding."
        ) from None
    except OSError as err:
        raise RecipeError(f"{path}: the recipe cannot be read ({err.strerror or err}).") from err
    return parse_recipe(text, path)


def parse_recipe(text: str, path: Path) -> Recipe:
    """Return the recipe in `text`, which was read from `path` (for messages and relative paths).

    Raises:
        RecipeError: as for `load_recipe`.
    """
    path = path.absolute()
    recipe, data, places = _as_written(text, path)
    recipe = _absolute(recipe, path.parent)
    problems = list(problems_in(recipe, data))
    if problems:
        raise RecipeError(*_sentences(problems, data, places, path))
    return recipe


def paths_written(path: Path) -> list[Path]:
    """Return the paths that a recipe names, as it writes them below its folder: links on the way are not followed.

    Raises:
        RecipeError: as for `load_recipe`.
        OSError: the recipe cannot be read.
    """
    recipe, _, _ = _as_written(path.read_text(encoding="utf-8"), path)
    written = [*(one for _, one in paths_in(recipe)), *(_output_of(dataset) for dataset in recipe.datasets)]
    return [path.absolute().parent / one for one in written]


def _as_written(text: str, path: Path) -> tuple[Recipe, JsonObject, Place]:
    """Return the recipe in `text` with its paths as they are, the data that it was made from, and where that stands.

    Raises:
        RecipeError: as for `load_recipe`.
    """
    data, places = read_yaml(text, path)
    if not isinstance(data, dict):
        found = (
            "is empty" if data is None else f"starts with a {'list' if isinstance(data, list) else 'text'}"
        )
        raise RecipeError(
            f"{path}:{places.line}: the recipe {found}; it is a YAML mapping with the fields name, bags and rigs."
        )
    recipe, problems = _validated(data)
    problems += undecided(data)
    questions = open_questions(problems, data)
    if questions:  # they stop the recordings of their rigs only
        recipe, others = _validated(with_stand_ins(data, questions))
        problems = [*problems, *others] if others else []
    if recipe is None or problems:
        raise RecipeError(*_sentences(problems, data, places, path))
    rigs = tuple(
        rig.with_questions(_sentences(questions[number], data, places, path)) if number in questions else rig
        for number, rig in enumerate(recipe.rigs)
    )
    return recipe.model_copy(update={"rigs": rigs}), data, places


def _validated(data: JsonObject) -> tuple[Recipe | None, list[Problem]]:
    """Return the recipe in plain data, with the sections of installed formats, and the problems in it."""
    try:
        # Through JSON, because only there does strict mean what a file can say: lists for tuples, text
        # for paths, but no text for numbers and no numbers for true and false.
        ours = {name: section for name, section in asked_formats(data).items() if name in OUR_FORMATS}
        recipe = Recipe.model_validate_json(json.dumps(ours | data), strict=True)
    except ValidationError as err:
        return None, explain_all(_causes(err), data)
    sections, problems = _read_sections(data)
    return recipe.model_copy(update={"formats": sections}), problems


def where_in(path: Path, at: tuple[str | int, ...]) -> str:
    """Return `file:line: field` of a value in a recipe, for errors that show only when the value is used."""
    try:
        data, places = read_yaml(path.read_text(encoding="utf-8"), path)
    except (OSError, UnicodeDecodeError, RecipeError):
        return f"{path}: {_field_name(at, None)}"  # it was readable before, and has changed
    return f"{path}:{places.line_of(at)}: {_field_name(at, data)}"


def _causes(err: ValidationError) -> list[ErrorDetails]:
    """Return the errors, except those about a list that is too short because of its wrong entries."""
    errors = err.errors()
    inner = {error["loc"][:depth] for error in errors for depth in range(len(error["loc"]))}
    return [error for error in errors if error["type"] != "too_short" or error["loc"] not in inner]


def _sentences(problems: Iterable[Problem], data: JsonObject, places: Place, path: Path) -> list[str]:
    found = sorted({(places.line_of(at), _field_name(at, data), sentence) for at, sentence in problems})
    return [
        f"{path}:{line}: {field}: {sentence}{'' if sentence.endswith('?') else '.'}"
        for line, field, sentence in found
    ]


def _field_name(location: tuple[str | int, ...], data: Json) -> str:
    """Return a location as users write it: `rigs[van].channels.CAM_FRONT.quality`.

    Args:
        location: field names, keys, indices.
        data: the recipe as plain data, for the names of its rigs; a rig without a name of its own gets its index.
    """
    name = ""
    for depth, part in enumerate(location):
        if isinstance(part, int):
            is_rig = location[:depth] == ("rigs",) and isinstance(data, dict)
            name += f"[{_rig_name(data['rigs'], part) if is_rig else part}]"
        else:
            name += f".{part}" if name else part
    return name or "recipe"


def _rig_name(rigs: Json, number: int) -> str:
    """Return the name of a rig, or its index if it has none, or none of its own."""
    names = [rig.get("name") if isinstance(rig, dict) else None for rig in rigs]
    name = names[number]
    return name if isinstance(name, str) and name and names.count(name) == 1 else f"{number}"


def _output_of(dataset: NamedDataset) -> Path:
    return dataset.output or Path("dataset") / dataset.name


def _absolute(recipe: Recipe, folder: Path) -> Recipe:
    """Return a recipe whose paths are absolute."""
    datasets = tuple(one.model_copy(update={"output": _output_of(one)}) for one in recipe.datasets)
    found = cast("Recipe", _resolved(recipe.model_copy(update={"datasets": datasets}), folder))
    return found.model_copy(update={"bags": found.bags.with_state(found.state)})


def _resolved(value: object, folder: Path) -> object:
    """Return a recipe, or a part of it, with the paths in it resolved."""
    match value:
        case Path():
            return (folder / value).resolve()
        case DatasetSettings():  # only the format knows which of its paths are relative
            return value.with_absolute_paths(folder)
        case BaseModel():
            # What stays as it is must not count as given.
            update = {name: new for name, old in value if (new := _resolved(old, folder)) != old}
            return value.model_copy(update=update)
        case dict():
            return {name: _resolved(inner, folder) for name, inner in value.items()}
        case tuple():
            return tuple(_resolved(inner, folder) for inner in value)
    return value


def _read_sections(data: JsonMapping) -> tuple[JsonObject, list[Problem]]:
    """Return the sections below `formats`, and the problems in them.

    A section whose package is installed but cannot be used stays plain data: everything else works, and the catalogue of
    formats reports the package.

    Args:
        data: the whole recipe as plain data.
    """
    sections: JsonObject = {}
    problems: list[Problem] = []
    for name, value in data.get("formats", {}).items():
        sections[name] = value
        try:
            model = None if name in OUR_FORMATS else section_model(name)
        except PluginError:
            continue
        if model is None:
            problems.append((("formats", name), _unknown_format(name)))
            continue
        try:
            sections[name] = model.model_validate_json(json.dumps(value), strict=True)
        except ValidationError as err:
            errors = err.errors()
            problems += explain_all(({**one, "loc": ("formats", name, *one["loc"])} for one in errors), data)
    return sections, problems


def _unknown_format(name: str) -> str:
    if name in OUR_FORMATS:
        return f"{name} is a section at the top level of the recipe; move it there"
    known = sorted({extension.name for extension in installed_extensions(FORMATS)})
    if not known:
        return f"no installed package adds a format {name}; install the one that does"
    near = closest(name, known)
    hint = f"did you mean {near}?" if near else f"the formats of installed packages are {', '.join(known)}"
    return f"no installed package adds a format {name}; {hint}"
