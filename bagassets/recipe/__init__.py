"""The recipe: the configuration of a project, validated and typed."""

from bagassets.recipe.load import load_recipe, parse_recipe, where_in
from bagassets.recipe.model import Recipe, Rig

__all__ = ["Recipe", "Rig", "load_recipe", "parse_recipe", "where_in"]
