"""A project that lasts for one build: its state in the temporary folder, its store and dataset beside where the dataset goes."""

import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from bagassets.base.errors import DatasetError
from bagassets.base.files import replacing
from bagassets.cli.remote import scratch_folders
from bagassets.formats.format import AnyFormat
from bagassets.formats.guard import GUARD
from bagassets.recipe.format_settings import OUR_FORMATS
from bagassets.recipe.model import Bags, Recipe


@dataclass(frozen=True)
class ThrowAwayProject:
    """A recipe of which only one recording and one dataset are built.

    Attributes:
        recipe_file: recipe of the project.
        dataset: folder of the dataset.
        store: the store, on the same file system as the dataset, so that its files are linked and not copied.
    """

    recipe_file: Path
    dataset: Path
    store: Path

    def move_dataset(self, out: Path) -> None:
        """Move the finished dataset to `out`, which must not exist; its files are nobody else's then.

        Raises:
            DatasetError: it cannot be moved.
        """
        try:
            shutil.rmtree(self.store)
            (self.dataset / GUARD).unlink(missing_ok=True)
            for folder, _, names in os.walk(self.dataset):
                for name in names:
                    _make_own(Path(folder, name))
            if os.path.lexists(out):
                raise FileExistsError(None, "it appeared meanwhile")
            self.dataset.rename(out)
        except OSError as err:
            raise DatasetError(
                f"{out}: the dataset cannot be put there ({err.strerror or err}); name another folder."
            ) from err


@contextmanager
def throw_away_project(recipe: Recipe, bags: Bags, kind: AnyFormat, out: Path) -> Iterator[ThrowAwayProject]:
    """Make a project that builds one dataset of the recording that `bags` selects, and remove all of it afterwards.

    Its server is ended, too. The recording is only read: no digest is stored with it.

    Args:
        recipe: how recordings are read; its folders and its other datasets do not count.
        bags: select the recording.
        kind: format of the dataset, whose section the recipe has.
        out: where the dataset is going to be.

    Raises:
        DatasetError: nothing can be written beside `out`.
    """
    with scratch_folders(out) as (state, beside):
        project = ThrowAwayProject(state / "recipe.yaml", beside / "dataset", beside / "store")
        own = _own_recipe(recipe, bags, kind, project, state)
        project.recipe_file.write_text(json.dumps(own, ensure_ascii=False), encoding="utf-8")
        yield project


def _own_recipe(
    recipe: Recipe, bags: Bags, kind: AnyFormat, project: ThrowAwayProject, state: Path
) -> dict[str, object]:
    """Return the recipe of the project as JSON, which is YAML."""
    own = recipe.model_dump(mode="json", exclude_unset=True)
    del own["datasets"]
    sections = own.pop("formats") | {name: own.pop(name) for name in OUR_FORMATS if name in own}
    section = sections[kind.name] | {"output": str(project.dataset)}
    own |= {"formats": {kind.name: section}} if kind.distribution else {kind.name: section}
    own["bags"] |= bags.model_dump(mode="json", include={"root", "include", "series"})
    own["bags"] |= {"exclude": [], "digest_attributes": False}
    own |= {"state": str(state), "store": str(project.store)}
    return own


def _make_own(path: Path) -> None:
    """Make a file of a dataset one that its user may write to, and no link to another."""
    if path.stat().st_nlink > 1:
        with replacing(path) as copy:
            shutil.copyfile(path, copy)
    path.chmod(path.stat().st_mode | 0o200)
