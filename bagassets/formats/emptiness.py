"""Datasets that hold nothing although there are recordings, are no longer asked for, or are replaced by turns; and the way out."""

import os
from collections.abc import Collection, Iterator
from contextlib import suppress
from pathlib import Path

from bagassets.base.errors import DatasetError
from bagassets.base.quantities import count_text
from bagassets.engine.freshness.published import Publication, on_record
from bagassets.formats.dataset_build import Dataset, datasets_of, made_once
from bagassets.formats.dataset_lock import LOCK
from bagassets.formats.format import FACTS
from bagassets.formats.guard import GUARD
from bagassets.recipe.format_settings import section_at
from bagassets.recipe.load import where_in
from bagassets.recipe.model import Recipe
from bagassets.store.canonical import digest_bytes
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


def replaced(recipe: Recipe) -> Iterator[str]:
    """Yield a sentence about each dataset that is another one than this project has made there, as of another project."""
    for asset, dataset in datasets_of(recipe).items():
        record = Publication(recipe.state, asset)
        roots, digests = record.places()
        made = digests.get(os.path.relpath(dataset.folder / LOCK, dataset.published_in))
        if made and roots[0] == str(dataset.published_in) and record.torn_since_s is None:
            with suppress(DatasetError):
                if dataset.lock is not None and digest_bytes(dataset.lock.text) != made:
                    yield (
                        f"{dataset.folder}: something else has put another dataset here since this project made its own; if another "
                        "project or checkout did, each replaces that of the other: give one of them another `output`."
                    )


def left_behind(recipe: Recipe) -> dict[Path, str]:
    """Return folder -> a sentence, for each dataset that an earlier build made and the recipe does not ask for."""
    made, found = made_once(recipe), {}
    asked = [one.published_in for one in made.values()]
    folders = {one.folder for one in made.values() if isinstance(one, Dataset)}
    for asset in sorted(on_record(recipe.state)):
        roots, names = Publication(recipe.state, asset).places()
        tables = {Path(name).parent for name in names if name.endswith(LOCK)}
        # In a copy of a project, the folders on record are those of the original, which goes on.
        own = [root for root in map(Path, roots) if recipe.state.parent in root.parents]
        ways = dict.fromkeys(own, "name it as an `output`")
        if asset in made:
            ways.pop(made[asset].published_in, None)
        elif roots:
            add = f"add `{'.'.join(section_at(asset.removesuffix('_dataset')))}: {{}}` to it"
            ways[Path(roots[0])] = "name it in its `datasets`" if asset.startswith("dataset_") else add
        for root, again in ways.items():
            if any(one in (root, *root.parents) or root in one.parents for one in asked):
                # Others are beside it in one dataroot: its tables tell whether it is still there.
                inside = {root / one for one in tables} - folders - {root}
                left = [folder for folder in inside if (folder / LOCK).exists()]
            else:
                left = [root] if (root / GUARD).exists() else []
            for folder in left:
                found[folder] = (
                    f"{folder}: this dataset is no longer brought up to date and stays as it is, because the recipe does not "
                    f"ask for it; {again}, or remove the folder."
                )
    return found
