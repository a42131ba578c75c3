"""How much disk a build is going to need, from what is on record: no recording is opened for it."""

import shutil
from collections.abc import Collection, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from bagassets.base.errors import StoreError
from bagassets.base.quantities import count_text, readable_bytes
from bagassets.engine.plan import BagPlan, Plan
from bagassets.engine.recording_assets import RecordingAssets
from bagassets.recipe.format_settings import section_at
from bagassets.recipe.model import Recipe
from bagassets.store.store import Store
from bagassets.store.writable import nearest_existing

# Manifests list thousands of files; a few recordings tell as much as all of them.
_MOST_COMPARED = 3
# Recordings of one rig differ in what they hold: with half of the estimate free, a build may well succeed.
_SURELY_NEEDED = 0.5


@dataclass(frozen=True)
class SpaceNeeded:
    """What a build is going to write into the store, roughly.

    Attributes:
        recordings: number of recordings whose images or sweeps are extracted for the first time.
        recorded_bytes: their size.
        bytes: what will be written; the size of the recordings, if none was built before.
        is_measured: recordings that were built before say so.
    """

    recordings: int
    recorded_bytes: int
    bytes: int
    is_measured: bool

    def __str__(self) -> str:
        what = f"Images and clouds to extract from {count_text(self.recordings, 'recording')} ({readable_bytes(self.recorded_bytes)})"
        if self.is_measured:
            return f"{what}: about {readable_bytes(self.bytes)} of disk space"
        return f"{what}: less disk space than that if recorded raw, several times as much if as video or lidar packets"


def space_needed(
    plan: Plan, sizes: Mapping[str, int], todo: Collection[str], assets: RecordingAssets
) -> SpaceNeeded | None:
    """Return what is needed to build some recordings; None if none of them is new with images or sweeps to extract.

    Images and clouds take, for each byte of a recording, what those of recordings that are built take. If there are none,
    nothing tells: raw images become smaller JPEG, packets of a lidar points of 20 bytes, video single images.

    Args:
        plan: states of all recordings.
        sizes: size of each recording in bytes.
        todo: the recordings.
        assets: the assets of recordings. Only the files of those of channels grow with a recording; the others take kilobytes.
    """
    large = [asset.name for asset in assets if asset.extract is not None]
    extracted = [key for key in todo if _extracts(plan.bags[key], large)]
    if not extracted:
        return None
    recorded_bytes = sum(sizes[key] for key in extracted)
    built = [key for key, bag in plan.bags.items() if key in sizes and bag.settled and bag.skipped is None]
    compared = built[:: max(1, len(built) // _MOST_COMPARED)][:_MOST_COMPARED]
    size = sum(sizes[key] for key in compared)
    if not size:
        return SpaceNeeded(len(extracted), recorded_bytes, recorded_bytes, is_measured=False)
    written = sum(_bytes_of(assets.store, plan.bags[key].artifacts) for key in compared)
    return SpaceNeeded(
        len(extracted), recorded_bytes, round(recorded_bytes * written / size), is_measured=True
    )


def require_disk_space(needed: SpaceNeeded, folders: Mapping[str, Path], *, ignore: bool = False) -> str:
    """Return one line on what is needed and what there is.

    Args:
        needed: by the build.
        folders: field of the recipe -> folder on a file system of its own that all of it is written to.
        ignore: refuse nothing.

    Raises:
        StoreError: one of them has much too little.
    """
    texts = []
    for field, folder in folders.items():
        # For this user, in a folder that need not exist yet.
        free = shutil.disk_usage(nearest_existing(folder)).free
        if needed.is_measured and not ignore and free < needed.bytes * _SURELY_NEEDED:
            raise StoreError(
                f"{folder}: only {readable_bytes(free)} are free here, and the build needs about "
                f"{readable_bytes(needed.bytes)} for {count_text(needed.recordings, 'recording')}, going by those that are built; free "
                f"space (`bagassets gc` removes what nothing uses), set `{field}` in the recipe to a folder on a larger "
                "disk, build fewer with --bag, or go ahead with --ignore-disk-space."
            )
        texts.append(f"{readable_bytes(free)} free in {folder}")
    return f"{needed}; {', '.join(texts)}"


def folders_written(store: Path, recipe: Recipe) -> dict[str, Path]:
    """Return field of the recipe -> folder: a dataset takes space of its own where it cannot link to the store."""
    outputs = {
        ".".join((*section_at(name), "output")): section.output
        for name, section in recipe.dataset_settings.items()
    }
    apart = {field: folder for field, folder in outputs.items() if _device(folder) != _device(store)}
    return {"store": store, **apart}


def _extracts(bag: BagPlan, large: Collection[str]) -> bool:
    """Tell whether images or sweeps are certainly to be written.

    What was made before may be in the store: a recording that was only touched needs nothing, and is not known
    from one with new content until its run has hashed it.
    """
    states = {name: bag.assets[name].state for name in large if name in bag.assets}
    return any(
        state not in {"fresh", "record-only", "skipped"} and name not in bag.recorded
        for name, state in states.items()
    )


def _bytes_of(store: Store, artifacts: Iterable[str]) -> int:
    """Return the size of artifacts: frames and sweeps only name those of their channels, so nothing counts twice."""
    size = 0
    for digest in set(artifacts):
        with suppress(StoreError):
            size += sum(entry.size for entry in store.artifact(digest).entries())
    return size


def _device(folder: Path) -> int:
    return nearest_existing(folder).stat().st_dev
