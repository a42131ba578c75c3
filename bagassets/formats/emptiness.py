"""Datasets that hold nothing, although there are recordings, or that nothing asks for any more, and the way out."""

from collections.abc import Collection, Iterator
from pathlib import Path

from bagassets.base.quantities import count_text
from bagassets.engine.freshness.published import Publication
from bagassets.formats.dataset_build import datasets_of
from bagassets.formats.format import FACTS
from bagassets.recipe.format_settings import DEFAULT_FORMAT, section_at
from bagassets.recipe.load import where_in
from bagassets.recipe.model import Recipe
from bagassets.store.store import Store


def why_empty(recipe: Recipe, recipe_file: Path, store: Store, assets: Collection[str]) -> str:
    """Return a sentence about each dataset on disk that has recordings, and nothing of them; "" if there is none.

    A named dataset may be empty: its conditions say so.

    Args:
        recipe: the recipe.
        recipe_file: where it is.
        store: has the artifacts.
        assets: those of the datasets to look at.

    Raises:
        DatasetError: a lock cannot be read.
    """
    sentences = []
    for asset, dataset in datasets_of(recipe).items():
        if asset not in assets or dataset.selection is not None:
            continue
        lock = dataset.lock
        bags = () if lock is None else tuple(lock.bags.values())
        if bags and all(bag.counts and not any(bag.counts.values()) for bag in bags):
            facts = [store.artifact(bag.artifact).read_json(FACTS) for bag in bags]
            why = dataset.kind.why_empty(facts, recipe, recipe_file) or (
                f"its settings leave nothing of them ({where_in(recipe_file, section_at(dataset.kind.name))})"
            )
            what = f"0 {next(iter(bags[0].counts))} from {count_text(len(bags), 'recording')}"
            sentences.append(f"{dataset.kind.name}: {what}: {why}.")
    return " ".join(sentences)


def left_behind(recipe: Recipe) -> Iterator[str]:
    """Yield a sentence about a dataset on disk that a former version made without being asked in the recipe."""
    if DEFAULT_FORMAT not in recipe.dataset_settings:
        root = Publication(recipe.state, f"{DEFAULT_FORMAT}_dataset").root
        if root is not None and Path(root).is_dir():
            yield (
                f"{root}: this dataset is no longer brought up to date, because the recipe names other formats but not "
                f"{DEFAULT_FORMAT}; add `{DEFAULT_FORMAT}: {{}}` to it, or remove the folder."
            )
