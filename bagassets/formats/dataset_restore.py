"""Restoring a dataset from its lock file and the store, byte for byte."""

from pathlib import Path

from pydantic import ValidationError

from bagassets.base.errors import DatasetError
from bagassets.formats.assembly import assemble
from bagassets.formats.catalogue import format_of
from bagassets.formats.dataset_lock import LOCK, DatasetLock
from bagassets.formats.format import Part
from bagassets.recipe.model import Recipe
from bagassets.recipe.model_splits import Splits
from bagassets.store.canonical import digest_bytes
from bagassets.store.lease import in_use
from bagassets.store.store import Store


def default_output(lock: DatasetLock, recipe: Recipe) -> Path:
    """Return where to restore a dataset: in place if the lock is in one, else beside the recipe's output."""
    folder = lock.path.parent
    if lock.path.name == LOCK and (folder / next(iter(lock.files), LOCK)).exists():
        return folder.parent
    section = recipe.dataset_settings.get(lock.kind)
    output = recipe.output if section is None else section.output
    return output.with_name(f"{output.name}-{digest_bytes(lock.text)[:8]}")


def restore_dataset(lock: DatasetLock, store: Store, output: Path) -> Path:
    """Restore the dataset of a lock; return its folder.

    Args:
        lock: the lock file.
        store: has the artifacts.
        output: folder of the dataset; files that are there already and belong to it stay.

    Raises:
        DatasetError: an artifact is missing, the lock's settings are invalid, or this version of bagassets makes
            other tables; then the dataset in `output` stays as it was.
    """
    kind = format_of(lock)
    missing = [bag.key for bag in lock.bags.values() if not all(map(store.has, bag.needs))]
    if missing:
        more = f" and {len(missing) - 5} more" if len(missing) > 5 else ""
        raise DatasetError(
            f"{lock.path}: artifacts of {', '.join(missing[:5])}{more} are not in the store {store.root}, so this dataset "
            "cannot be made again; build it from the recordings, with the recipe and version that made it."
        )
    parts = {key: Part(key, bag.content, bag.artifact) for key, bag in lock.bags.items()}
    for copy, first in lock.value["duplicates"].items():
        parts[copy] = Part(copy, parts[first].content, parts[first].artifact)
    with in_use(store.root):
        try:
            settings = kind.settings.model_validate({**lock.settings, "output": output})
            splits = Splits.model_validate(lock.value["splits"])
        except ValidationError as err:
            field = ".".join(str(part) for part in err.errors()[0]["loc"])
            raise DatasetError(
                f"{lock.path}: its settings are invalid here (field {field}: {err.errors()[0]['msg']}); use the version "
                f"of {kind.distribution or 'bagassets'} that wrote it."
            ) from err
        restored = assemble(
            kind,
            list(parts.values()),
            settings,
            store,
            output,
            splits=splits,
            dealt=lock.splits,
            skipped=lock.value["skipped"],
            failed=lock.value["failed"],
            damaged=lock.value.get("damaged"),
            expected=lock.files,
        )
    return restored.folder
