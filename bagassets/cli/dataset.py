"""`bagassets dataset`: comparing datasets, and restoring one from its lock."""

import json
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import click

from bagassets.base.json_types import JsonObject
from bagassets.base.quantities import count_text
from bagassets.cli.exit_status import ExitStatus
from bagassets.cli.options import recipe_option
from bagassets.cli.terminal import echo, echo_json

if TYPE_CHECKING:
    from bagassets.formats.dataset_diff import BagDiff, DatasetDiff, SceneDiff
    from bagassets.formats.dataset_lock import DatasetLock, LockedBag

_MOST_SHOWN = 5
_SIGNS = {"added": "+", "removed": "-", "changed": "~", "renamed": ">"}


@click.group(
    epilog="""\b
Examples:
  bagassets dataset diff releases/may.lock.json dataset/nuscenes
  bagassets dataset restore releases/may.lock.json"""
)
def dataset() -> None:
    """Compare datasets, and restore one from its lock.

    The lock of a dataset is the file `dataset.lock.json` in its version folder. It names every recording and artifact
    that the dataset was made from: keep a copy of it with every model trained on the dataset.
    """


@dataset.command(
    epilog="""\b
Examples:
  bagassets dataset diff releases/may.lock.json dataset/nuscenes
  bagassets dataset diff old/v1.0-custom new/v1.0-custom --json

\b
Exit status:
  0  the datasets are the same
  1  a lock cannot be read
  3  they differ"""
)
@click.argument("before", metavar="A", type=click.Path(exists=True, path_type=Path))
@click.argument("after", metavar="B", type=click.Path(exists=True, path_type=Path))
@recipe_option
@click.option(
    "--json", "as_json", is_flag=True, help="Print one JSON document, with the tokens of all samples."
)
def diff(before: Path, after: Path, recipe: Path, as_json: bool) -> int:
    """Show which recordings, scenes and samples differ between two datasets.

    A and B are lock files or folders of datasets. The samples are read from the store that the recipe names.
    """
    from bagassets.formats.dataset_diff import diff_datasets
    from bagassets.formats.dataset_lock import load_lock
    from bagassets.recipe import load_recipe
    from bagassets.store.store import Store

    store = Store(load_recipe(recipe).store_path)
    one, other = load_lock(before), load_lock(after)
    found = diff_datasets(one, other, store)
    if as_json:
        echo_json({"a": _lock_json(one), "b": _lock_json(other), **_diff_json(found)})
    else:
        _show(one, other, found)
    return 0 if found.is_empty else ExitStatus.FOUND


@dataset.command(
    epilog="""\b
Examples:
  bagassets dataset restore releases/may.lock.json
  bagassets dataset restore releases/may.lock.json --output /data/may

\b
Exit status:
  0  the dataset is restored, byte for byte as locked
  1  artifacts are missing, or this version of bagassets makes different tables"""
)
@click.argument("lock", type=click.Path(exists=True, path_type=Path))
@recipe_option
@click.option(
    "--output",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="DIR",
    help="Folder of the dataset. Default: the dataset that the lock is in, else a folder beside the dataset of the "
    "recipe, named after the lock.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
def restore(lock: Path, recipe: Path, output: Path | None, as_json: bool) -> None:
    """Restore the dataset of a lock, byte for byte.

    All its artifacts must be in the store; `bagassets gc --lock LOCK` keeps them there, and so does a copy of the lock in
    `kept-locks` of the state folder.
    """
    from bagassets.formats.dataset_lock import load_lock
    from bagassets.formats.dataset_restore import default_output, restore_dataset
    from bagassets.recipe import load_recipe
    from bagassets.store.store import Store

    loaded = load_recipe(recipe)
    found = load_lock(lock)
    folder = default_output(found, loaded) if output is None else output.absolute()
    made = restore_dataset(found, Store(loaded.store_path), folder)
    if as_json:
        echo_json({"folder": str(made), "lock": _lock_json(found)})
    else:
        echo(f"{made}: {_counts(found)}, as in {found.path}")


def _show(before: "DatasetLock", after: "DatasetLock", found: "DatasetDiff") -> None:
    echo(f"A {before.path}: {_counts(before)}")
    echo(f"B {after.path}: {_counts(after)}")
    if found.is_empty:
        echo("The datasets are the same.")
        return
    for bag in found.bags:
        echo(f"{_SIGNS[bag.change]} {bag.key}: {_bag_text(bag, has_samples=found.has_samples)}")
        for scene in bag.scenes or ():
            if bag.change == "changed":
                echo(f"    {_SIGNS[scene.change]} {scene.name}: {_scene_text(scene)}")
    for why, keys in found.left_out.items():
        for key, (old, new) in keys.items():
            echo(f"{why} {key}: {old or 'not before'} -> {new or 'not any more'}")
    for field, (old, new) in found.settings.items():
        echo(f"setting {field}: {json.dumps(old)} -> {json.dumps(new)}")
    echo(f"files that differ: {', '.join(found.files) or 'none'}")


def _counts(lock: "DatasetLock") -> str:
    return ", ".join([count_text(len(lock.bags), "recording"), *_numbers(_totals(lock))])


def _totals(lock: "DatasetLock") -> dict[str, int]:
    totals: Counter[str] = Counter()
    for bag in lock.bags.values():
        totals.update(bag.counts)
    return dict(totals)


def _numbers(counts: Mapping[str, int]) -> list[str]:
    return [count_text(number, what.removesuffix("s")) for what, number in counts.items()]


def _bag_text(bag: "BagDiff", *, has_samples: bool) -> str:
    if bag.change in {"added", "removed"}:
        only = bag.after or bag.before
        return "" if only is None else ", ".join([*_numbers(only.counts), f"split {only.split}"])
    if bag.before is None or bag.after is None:
        return ""
    if bag.change == "renamed":
        return f"was {bag.before.key}"
    what = []
    if bag.before.content != bag.after.content:
        what.append("other content")
    if bag.before.split != bag.after.split:
        what.append(f"split {bag.before.split} -> {bag.after.split}")
    if has_samples and bag.scenes is None:
        what.append("its scenes are not known, because the store lacks an artifact")
    elif has_samples and not bag.scenes:
        what.append("the same samples")
    return ", ".join(what) or "the same content, made into other tables"


def _scene_text(scene: "SceneDiff") -> str:
    what = []
    if scene.added:
        what.append(f"{count_text(len(scene.added), 'sample')} added")
    if scene.removed:
        what.append(f"{len(scene.removed)} removed")
    if scene.changed:
        parts = sorted({part for parts in scene.changed.values() for part in parts})
        tokens = list(scene.changed)
        more = " …" if len(tokens) > _MOST_SHOWN else ""
        what.append(f"{len(tokens)} changed ({', '.join(parts)}): {' '.join(tokens[:_MOST_SHOWN])}{more}")
    return ", ".join(what)


def _lock_json(lock: "DatasetLock") -> JsonObject:
    return {"path": str(lock.path), "kind": lock.kind, "recordings": len(lock.bags), **_totals(lock)}


def _bag_json(bag: "LockedBag | None") -> JsonObject | None:
    if bag is None:
        return None
    value = {"key": bag.key, "content": bag.content, "artifact": bag.artifact, "split": bag.split}
    return {**value, **bag.counts}


def _diff_json(found: "DatasetDiff") -> JsonObject:
    return {
        "same": found.is_empty,
        "bags": [
            {
                "key": bag.key,
                "change": bag.change,
                "before": _bag_json(bag.before),
                "after": _bag_json(bag.after),
                "scenes": None
                if bag.scenes is None
                else [
                    {
                        "name": scene.name,
                        "change": scene.change,
                        "samples_added": list(scene.added),
                        "samples_removed": list(scene.removed),
                        "samples_changed": {token: list(parts) for token, parts in scene.changed.items()},
                    }
                    for scene in bag.scenes
                ],
            }
            for bag in found.bags
        ],
        "left_out": {why: {k: list(v) for k, v in keys.items()} for why, keys in found.left_out.items()},
        "settings": {name: list(values) for name, values in found.settings.items()},
        "files": list(found.files),
    }
