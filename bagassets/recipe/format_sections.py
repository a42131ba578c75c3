"""Reading the sections below `formats`, whose formats installed packages add."""

import json
from collections.abc import Iterator

from pydantic import ValidationError

from bagassets.errors import PluginError
from bagassets.extensions import FORMATS, installed_extensions
from bagassets.json_types import JsonMapping, JsonObject
from bagassets.recipe.explain import Problem, closest, explain
from bagassets.recipe.format_settings import section_model

__all__ = ["read_sections"]


def read_sections(data: JsonMapping) -> tuple[JsonObject, list[Problem]]:
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
            model = section_model(name)
        except PluginError:
            continue
        if model is None:
            problems.append((("formats", name), _unknown(name)))
            continue
        try:
            sections[name] = model.model_validate_json(json.dumps(value), strict=True)
        except ValidationError as err:
            problems += _explained(name, err, data)
    return sections, problems


def _explained(name: str, err: ValidationError, data: JsonMapping) -> Iterator[Problem]:
    for error in err.errors():
        yield explain({**error, "loc": ("formats", name, *error["loc"])}, data)


def _unknown(name: str) -> str:
    known = sorted({extension.name for extension in installed_extensions(FORMATS)})
    if not known:
        return f"no installed package adds a format {name}; install the one that does"
    near = closest(name, known)
    hint = f"did you mean {near}?" if near else f"there are {', '.join(known)}"
    return f"no installed package adds a format {name}; {hint}"
