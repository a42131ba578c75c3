"""The locks whose artifacts garbage collection must keep."""

from collections.abc import Iterator
from pathlib import Path

from bagassets.errors import DatasetError
from bagassets.formats.dataset_build import dataset_folders
from bagassets.formats.dataset_lock import LOCK
from bagassets.recipe.model import Recipe

__all__ = ["KEPT_LOCKS", "locks_of"]

KEPT_LOCKS = "kept-locks"
"""Folder in the state folder: copies of locks whose datasets must stay restorable."""


def locks_of(recipe: Recipe) -> Iterator[Path]:
    """Yield the locks of all datasets of a recipe, of every version on disk, and the locks in `KEPT_LOCKS`.

    Raises:
        DatasetError: the package of a format in the recipe cannot be used, so nobody knows where its locks are.
    """
    unusable = sorted(recipe.formats.keys() - recipe.dataset_settings.keys())
    if unusable:
        raise DatasetError(
            f"formats.{unusable[0]} in the recipe: the package of this format cannot be used (`bagassets formats` says "
            "why), so the artifacts that its datasets need are unknown, and nothing is collected; repair the package, "
            "or remove the section and copy the locks whose datasets must stay restorable to "
            f"{recipe.state / KEPT_LOCKS}."
        )
    for folder in dataset_folders(recipe).values():
        yield from sorted(folder.glob(f"*/{LOCK}"))
    yield from sorted((recipe.state / KEPT_LOCKS).glob("**/*.json"))
