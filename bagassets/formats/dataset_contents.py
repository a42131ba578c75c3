"""What a dataset has of which recordings, beside what it would have now."""

from collections.abc import Mapping
from dataclasses import dataclass

from bagassets.formats.dataset_build import DatasetInputs, datasets_of, made_from
from bagassets.formats.dataset_lock import read_lock
from bagassets.recipe.model import Recipe

__all__ = ["DatasetContents", "dataset_contents"]


@dataclass(frozen=True)
class DatasetContents:
    """The recordings of a dataset.

    Attributes:
        part: the asset of recordings that it is made from.
        last: recording -> digest of what the dataset on disk has of it: its part, or, in a dataset of selected scenes, its
            content. None if that is not on record.
        now: the same for the dataset as it would be made now; one of selected scenes has some of these.
        left_out: recording -> why it is not in the dataset.
    """

    part: str
    last: Mapping[str, str] | None
    now: Mapping[str, str]
    left_out: Mapping[str, str]


def dataset_contents(recipe: Recipe, inputs: DatasetInputs, asset: str) -> DatasetContents:
    """Return what a dataset, or the map, has of which recordings; nothing is made.

    Raises:
        DatasetError: its lock cannot be read.
    """
    part, dataset = made_from(recipe)[asset], datasets_of(recipe).get(asset)
    if dataset is None:  # the map, which has no lock
        keys = {one.key: one.content for parts in inputs.parts.values() for one in parts}
        return DatasetContents(part, None, keys, inputs.skipped)
    lock = read_lock(dataset.settings.output / dataset.kind.folder(dataset.settings))
    is_whole = dataset.selection is None
    now: dict[str, str] = {}
    first: dict[str, str] = {}
    left_out = {**inputs.skipped, **inputs.failed.get(dataset.kind.name, {})}
    for one in inputs.parts.get(dataset.kind.name, ()):
        if first.setdefault(one.content, one.key) != one.key:
            left_out[one.key] = f"the same content as {first[one.content]}, which is in it for both"
        else:
            now[one.key] = one.artifact if is_whole else one.content
    if lock is None:
        return DatasetContents(part, {}, now, left_out)
    if not is_whole:  # which scenes are selected is known once they are made
        selected_out = {key: why for key, why in lock.value["skipped"].items() if key in now}
        left_out |= selected_out
        now = {key: digest for key, digest in now.items() if key not in selected_out}
    last = {key: bag.artifact if is_whole else bag.content for key, bag in lock.bags.items()}
    return DatasetContents(part, last, now, left_out)
