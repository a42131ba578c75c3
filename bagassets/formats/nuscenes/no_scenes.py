"""Why a dataset has no scene, although it has recordings, and the way out."""

from collections.abc import Sequence
from pathlib import Path

from bagassets.assets.quality.scene_rules import enough_s, too_short_s
from bagassets.base.json_types import JsonMapping
from bagassets.recipe.load import where_in
from bagassets.recipe.model import Recipe

__all__ = ["why_no_scenes"]


def why_no_scenes(recordings: Sequence[JsonMapping], recipe: Recipe, recipe_file: Path) -> str:
    """Return why recordings, given by the facts of their tables, have no scene, and what to set where so that they have one."""
    lengths_s = [too_short_s(facts) for facts in recordings]
    short_s = sorted(length_s for length_s in lengths_s if length_s is not None)
    if not short_s:
        return "`bagassets check` says why"
    number = "all" if len(short_s) == len(recordings) else f"{len(short_s)}"
    others = "" if number == "all" else "; `bagassets check` says why the others have none"
    range_s = " to ".join(dict.fromkeys(f"{length_s:g}" for length_s in (short_s[0], short_s[-1])))
    least_s = f"{enough_s(short_s[0]):g}"
    if "scenes" in recipe.model_fields_set:
        way_out = f"set it to {least_s} ({where_in(recipe_file, ('scenes', 'min_length_s'))})"
    else:
        way_out = f"add `scenes: {{min_length_s: {least_s}}}` to {recipe_file}"
    limit = f"scenes.min_length_s ({recipe.scenes.min_length_s:g})"
    return f"{number}, of {range_s} s, are shorter than {limit}; to have a scene of each, {way_out}{others}"
