"""Artifacts that dataset locks refer to: what a dataset is made from, and can be made again from."""

import json
from collections.abc import Iterator
from pathlib import Path

from bagassets.engine.dataset_build import dataset_folders
from bagassets.errors import DatasetError
from bagassets.recipe.model import Recipe

__all__ = ["KEPT_LOCKS", "locked_artifacts", "locks_of"]

LOCK = "dataset.lock.json"
KEPT_LOCKS = "kept-locks"
"""Folder in the state folder for copies of locks whose datasets are to stay restorable."""

_FIELDS = ("nuscenes_tables", "vision_sequences")


def locks_of(recipe: Recipe) -> Iterator[Path]:
    """Yield the locks of all datasets of a recipe, of every version that is on disk, and the locks kept by hand."""
    for folder in dataset_folders(recipe).values():
        yield from sorted(folder.glob(f"*/{LOCK}"))
    yield from sorted((recipe.state / KEPT_LOCKS).glob("**/*.json"))


def locked_artifacts(lock: Path) -> set[str]:
    """Return the artifacts that a lock file names.

    Raises:
        DatasetError: it is no lock file.
    """
    try:
        rows = json.loads(lock.read_bytes())["bags"]
        return {str(row[field]) for row in rows for field in _FIELDS if field in row}
    except (OSError, ValueError, KeyError, TypeError) as err:
        raise DatasetError(
            f"{lock}: expected the lock file of a dataset, but it cannot be read ({type(err).__name__}: {err}); remove it, or "
            "replace it by a good copy."
        ) from err
