"""Making a dataset again from its lock file and the store, byte for byte."""

from pathlib import Path

from pydantic import ValidationError

from bagassets.engine.dataset_lock import LOCK, DatasetLock, LockedBag
from bagassets.errors import DatasetError, StoreError
from bagassets.recipe.model import NuScenes, Recipe
from bagassets.recipe.model_splits import Splits
from bagassets.recipe.model_vision import Vision
from bagassets.steps.nuscenes_dataset import BagPart, assemble
from bagassets.steps.vision_dataset import VisionPart, assemble_vision
from bagassets.store.canonical import digest_bytes
from bagassets.store.lease import in_use
from bagassets.store.store import Store

__all__ = ["default_output", "missing_recordings", "restore_dataset"]

# Where the artifact of a recording names those of its files.
_FILES = "files.json"


def default_output(lock: DatasetLock, recipe: Recipe) -> Path:
    """Return where a dataset is restored to: in place, if the lock lies in one, else beside that of the recipe."""
    folder = lock.path.parent
    if lock.path.name == LOCK and (folder / next(iter(lock.files), LOCK)).exists():
        return folder.parent
    output = recipe.nuscenes.output
    if lock.kind == "vision" and recipe.vision is not None:
        output = recipe.vision.output
    return output.with_name(f"{output.name}-{digest_bytes(lock.text)[:8]}")


def missing_recordings(lock: DatasetLock, store: Store) -> list[str]:
    """Return the keys of recordings of which an artifact is not in the store (any more)."""
    return [key for key, bag in lock.bags.items() if not _is_there(bag, store)]


def restore_dataset(lock: DatasetLock, store: Store, output: Path) -> Path:
    """Make the dataset of a lock again; return the folder of its tables.

    Args:
        lock: the lock file.
        store: where the artifacts are.
        output: the dataset to write; what is there already stays if it belongs to it.

    Raises:
        DatasetError: an artifact is missing, the lock's settings are not understood, or this version of
            bagassets makes other tables; then the dataset in `output` stays as it was.
    """
    missing = missing_recordings(lock, store)
    if missing:
        more = f" and {len(missing) - 5} more" if len(missing) > 5 else ""
        raise DatasetError(
            f"{lock.path}: artifacts of {', '.join(missing[:5])}{more} are not in the store {store.root}, so this dataset "
            "cannot be made again; build it from the recordings, with the recipe and version that made it."
        )
    with in_use(store.root):
        try:
            return _nuscenes(lock, store, output) if lock.kind == "nuscenes" else _vision(lock, store, output)
        except ValidationError as err:
            field = ".".join(str(part) for part in err.errors()[0]["loc"])
            raise DatasetError(
                f"{lock.path}: its settings are not understood (field {field}: {err.errors()[0]['msg']}); use the version "
                "of bagassets that wrote it."
            ) from err


def _nuscenes(lock: DatasetLock, store: Store, output: Path) -> Path:
    settings = NuScenes.model_validate({**lock.value["nuscenes"], "output": output})
    parts = [BagPart(bag.key, bag.content, bag.artifact) for bag in lock.bags.values()]
    by_key = {part.key: part for part in parts}
    for copy, first in lock.value["duplicates"].items():
        parts.append(BagPart(copy, by_key[first].content, by_key[first].tables))
    made = assemble(
        parts,
        settings,
        store,
        output,
        splits=Splits.model_validate(lock.value["splits"]),
        dealt={bag.key: bag.split for bag in lock.bags.values()},
        skipped=lock.value["skipped"],
        failed=lock.value["failed"],
        expected=lock.files,
    )
    return made.folder


def _vision(lock: DatasetLock, store: Store, output: Path) -> Path:
    settings = Vision.model_validate({**lock.value["vision"], "output": output})
    parts = [VisionPart(bag.key, bag.content, bag.artifact) for bag in lock.bags.values()]
    by_key = {part.key: part for part in parts}
    for copy, first in lock.value["duplicates"].items():
        parts.append(VisionPart(copy, by_key[first].content, by_key[first].sequences))
    made = assemble_vision(
        parts,
        settings,
        Splits.model_validate(lock.value["splits"]),
        store,
        dealt={bag.key: bag.split for bag in lock.bags.values()},
        skipped=lock.value["skipped"],
        failed=lock.value["failed"],
        expected=lock.files,
    )
    return made.folder


def _is_there(bag: LockedBag, store: Store) -> bool:
    try:
        named = {row["artifact"] for row in store.artifact(bag.artifact).read_json(_FILES)}
    except StoreError:
        return False
    return all(store.has(digest) for digest in named)
