"""Datasets that hold nothing, although there are recordings, and the way out."""

from collections.abc import Collection
from pathlib import Path

from bagassets.assets.quality.scene_rules import enough_s, too_short_s
from bagassets.base.quantities import count_text
from bagassets.formats.catalogue import MAIN
from bagassets.formats.dataset_build import datasets_of
from bagassets.formats.dataset_lock import LockedBag
from bagassets.formats.format import FACTS
from bagassets.recipe.load import where_in
from bagassets.recipe.model import Recipe
from bagassets.store.store import Store

__all__ = ["why_empty"]


def why_empty(recipe: Recipe, recipe_file: Path, store: Store, chosen: Collection[str]) -> str:
    """Return a sentence about each dataset on disk that has recordings, and nothing of them; "" if there is none.

    A named dataset may be empty: its conditions say so.

    Args:
        recipe: the recipe.
        recipe_file: where it is.
        store: has the artifacts.
        chosen: assets of the datasets to look at.

    Raises:
        DatasetError: a lock cannot be read.
    """
    sentences = []
    for asset, dataset in datasets_of(recipe).items():
        if asset not in chosen or dataset.selection is not None:
            continue
        lock = dataset.lock
        bags = () if lock is None else tuple(lock.bags.values())
        if bags and all(bag.counts and not any(bag.counts.values()) for bag in bags):
            if dataset.kind is MAIN:
                why = _why_no_scenes(recipe, recipe_file, store, bags)
            else:
                why = f"its settings leave nothing of them ({where_in(recipe_file, tuple(dataset.kind.section.split('.')))})"
            what = f"0 {next(iter(bags[0].counts))} from {count_text(len(bags), 'recording')}"
            sentences.append(f"{dataset.kind.name}: {what}: {why}.")
    return " ".join(sentences)


def _why_no_scenes(recipe: Recipe, recipe_file: Path, store: Store, bags: Collection[LockedBag]) -> str:
    lengths_s = [too_short_s(store.artifact(bag.artifact).read_json(FACTS)) for bag in bags]
    short_s = sorted(length_s for length_s in lengths_s if length_s is not None)
    if not short_s:
        return "`bagassets check` says why"
    number = "all" if len(short_s) == len(bags) else f"{len(short_s)}"
    others = "" if number == "all" else "; `bagassets check` says why the others have none"
    range_s = " to ".join(dict.fromkeys(f"{length_s:g}" for length_s in (short_s[0], short_s[-1])))
    least_s = f"{enough_s(short_s[0]):g}"
    if "scenes" in recipe.model_fields_set:
        way_out = f"set it to {least_s} ({where_in(recipe_file, ('scenes', 'min_length_s'))})"
    else:
        way_out = f"add `scenes: {{min_length_s: {least_s}}}` to {recipe_file}"
    limit = f"scenes.min_length_s ({recipe.scenes.min_length_s:g})"
    return f"{number}, of {range_s} s, are shorter than {limit}; to have a scene of each, {way_out}{others}"
