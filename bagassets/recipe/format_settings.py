"""The sections of a recipe that ask for datasets, one for each format, and the models of their settings.

Our formats have sections at the top level, those of installed packages have theirs below `formats`.
"""

from collections.abc import Mapping
from functools import cache
from importlib import import_module
from typing import Any, TypeVar

from pydantic import Field, create_model

from bagassets.base.errors import PluginError
from bagassets.base.json_types import JsonMapping
from bagassets.base.plugins import FORMATS, Extension, installed_extensions
from bagassets.recipe.model_base import DatasetSettings, Model

OUR_FORMATS = {"nuscenes": "NuScenes", "vision": "Vision", "lerobot": "LeRobot"}
"""Folder in `formats/` -> model of the section, which is in its `settings.py`; in the order in which formats are listed."""

DEFAULT_FORMAT = next(iter(OUR_FORMATS))
"""The format of a recipe that names none, and of datasets of selected scenes."""

M = TypeVar("M", bound=Model)


@cache
def _our_model(name: str) -> type[DatasetSettings]:
    # By name, as those of packages are: a format knows the recipe, not the reverse.
    model: type[DatasetSettings] = getattr(
        import_module(f"bagassets.formats.{name}.settings"), OUR_FORMATS[name]
    )
    return model


def with_our_sections(base: type[M]) -> type[M]:
    """Return a model of the recipe with a section for each of our formats; None where a recipe has none."""
    sections: dict[str, Any] = {}
    for name in OUR_FORMATS:
        own = _our_model(name)
        what = (own.__doc__ or "").partition(":")[0].removesuffix(".")
        sections[name] = own, Field(None, description=f"{what}.")
    model = create_model(
        base.__name__, __base__=base, __doc__=base.__doc__, __module__=base.__module__, **sections
    )
    model.model_rebuild()  # here, and not in every process that is forked from this one
    return model


def asked_formats(recipe: JsonMapping) -> dict[str, object]:
    """Return format -> its section as plain data, for the datasets that a recipe, as plain data, asks for."""
    sections = {name: recipe[name] for name in OUR_FORMATS if recipe.get(name) is not None}
    installed = recipe.get("formats")
    sections |= installed if isinstance(installed, Mapping) else {}
    return sections if sections and not recipe.get("datasets") else {DEFAULT_FORMAT: {}} | sections


def section_at(name: str) -> tuple[str, ...]:
    """Return where in a recipe the section of a format is."""
    return (name,) if name in OUR_FORMATS else ("formats", name)


def section_model(name: str) -> type[DatasetSettings] | None:
    """Return the model of the section of a format; None if neither we nor an installed package have it.

    Raises:
        PluginError: the package cannot be used, or several packages add the format.
    """
    if name in OUR_FORMATS:
        return _our_model(name)
    found = [extension for extension in installed_extensions(FORMATS) if extension.name == name]
    if not found:
        return None
    if len(found) > 1:
        owners = " and ".join(extension.distribution for extension in found)
        raise PluginError(f"format {name}: {owners} both add it, so neither is used; uninstall all but one.")
    return settings_model(found[0], found[0].load())


def settings_model(extension: Extension, found: object) -> type[DatasetSettings]:
    """Return the model of the settings of a format.

    Raises:
        PluginError: the format has no such model.
    """
    model = getattr(found, "settings", None)
    if not (isinstance(model, type) and issubclass(model, DatasetSettings)):
        raise extension.problem(
            f"its settings are {model!r}, not a model derived from bagassets.recipe.model_base.DatasetSettings"
        )
    return model
