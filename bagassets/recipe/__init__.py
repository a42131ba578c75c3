"""The recipe: the configuration of a project, validated and typed.

What this names is imported when it is first used: the settings of a format need the models here, and the recipe needs them.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from bagassets.recipe.load import load_recipe, parse_recipe, where_in
    from bagassets.recipe.model import Recipe, Rig

__all__ = ["Recipe", "Rig", "load_recipe", "parse_recipe", "where_in"]


def __getattr__(name: str) -> object:
    if name not in __all__:
        raise AttributeError(f"module 'bagassets.recipe' has no attribute {name!r}")
    home = "model" if name in {"Recipe", "Rig"} else "load"
    return getattr(import_module(f"bagassets.recipe.{home}"), name)
