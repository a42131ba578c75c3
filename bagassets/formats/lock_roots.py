"""Locks that keep artifacts in the store: what datasets are made from, and can be made again from."""

from collections.abc import Iterator
from pathlib import Path

from bagassets.errors import DatasetError
from bagassets.formats.dataset_build import dataset_folders
from bagassets.formats.dataset_lock import LOCK
from bagassets.recipe.model import Recipe

__all__ = ["KEPT_LOCKS", "locks_of"]

KEPT_LOCKS = "kept-locks"
"""Folder in the state folder for copies of locks whose datasets are to stay restorable."""


def locks_of(recipe: Recipe) -> Iterator[Path]:
    """Yield the locks of all datasets of a recipe, of every version that is on disk, and the locks kept by hand.

    Raises:
        DatasetError: a dataset is in a format whose package cannot be used: nobody knows where its locks are.
    """
    unusable = sorted(recipe.formats.keys() - recipe.dataset_settings.keys())
    if unusable:
        raise DatasetError(
            f"formats.{unusable[0]} in the recipe: the package of this format cannot be used (`bagassets formats` says "
            "why), so what its datasets need of the store is not known, and nothing is collected; mend the package, "
            "or remove the section and copy the locks that are to stay restorable to "
            f"{recipe.state / KEPT_LOCKS}."
        )
    for folder in dataset_folders(recipe).values():
        yield from sorted(folder.glob(f"*/{LOCK}"))
    yield from sorted((recipe.state / KEPT_LOCKS).glob("**/*.json"))
