"""Lock files: from which artifacts a dataset was made.

A lock has the same keys for every format. `dataset` names the format, and the key of that name has its settings;
`bags` lists the recordings, each with the `artifacts` that the dataset needs, its part first; `files` has digests.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from bagassets.base.disk_errors import disk_advice
from bagassets.base.errors import DatasetError
from bagassets.base.garbage import uncollected
from bagassets.base.json_types import JsonMapping

LOCK = "dataset.lock.json"
FORMAT = 2


@dataclass(frozen=True)
class LockedBag:
    """A recording in a dataset.

    Attributes:
        key: partition key.
        content: digest of the recording.
        artifact: digest of its part.
        split: name of its split.
        counts: what the dataset has of it -> number, such as `scenes`.
        needs: artifacts that the dataset needs, its part first.
        row: its whole entry in the lock.
    """

    key: str
    content: str
    artifact: str
    split: str
    counts: Mapping[str, int]
    needs: Sequence[str] = field(compare=False)
    row: JsonMapping = field(compare=False)


@dataclass(frozen=True)
class DatasetLock:
    """A lock file.

    Attributes:
        path: the file.
        kind: name of the dataset's format.
        text: its bytes.
        value: its content.
        bags: the recordings by key, in order.
        files: digests of the tables, or of the merged files, by name.
    """

    path: Path
    kind: str
    text: bytes
    value: JsonMapping
    bags: Mapping[str, LockedBag]
    files: Mapping[str, str]

    @property
    def settings(self) -> JsonMapping:
        """The dataset's section of the recipe, without `output`."""
        settings: JsonMapping = self.value[self.kind]
        return settings

    @property
    def splits(self) -> Mapping[str, str]:
        """Recording -> split."""
        return {key: bag.split for key, bag in self.bags.items()}


@uncollected()
def load_lock(path: Path) -> DatasetLock:
    """Read a lock file.

    Args:
        path: the file, its folder, or a dataset with exactly one lock.

    Raises:
        DatasetError: there is none, there are several, or it cannot be read.
    """
    found = _find(path.absolute())
    try:
        text = found.read_bytes()
        value = json.loads(text)
        if value["format"] != FORMAT:
            raise DatasetError(
                f"{found}: this lock has format {value['format']}, this version of bagassets knows {FORMAT}; use the version "
                "that wrote it."
            )
        bags = {row["key"]: locked_bag(row) for row in value["bags"]}
        lock = DatasetLock(
            found, value["dataset"], text, value, dict(sorted(bags.items())), dict(value["files"])
        )
        lock.settings.items()
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as err:
        raise DatasetError(
            f"{found}: expected the lock file of a dataset, but it cannot be read ({_reason(err)}); "
            f"{disk_advice(err, 'name another')}."
        ) from err
    return lock


def read_lock(folder: Path) -> DatasetLock | None:
    """Return the lock in a folder of a dataset, or None if there is none.

    Raises:
        DatasetError: it cannot be read.
    """
    if not (folder / LOCK).exists():
        return None
    try:
        return load_lock(folder / LOCK)
    except DatasetError as err:
        cause = err.__cause__ if isinstance(err.__cause__, Exception) else err
        raise DatasetError(
            f"{folder / LOCK}: cannot be read ({_reason(cause)}); "
            f"{disk_advice(cause, 'remove the folder and build the dataset again')}."
        ) from err


def locked_artifacts(path: Path) -> set[str]:
    """Return the artifacts that a dataset needs, from its lock file.

    Raises:
        DatasetError: it is no lock file, or does not say what its dataset needs.
    """
    try:
        value = json.loads(path.read_bytes())
        return {digest for row in value["bags"] for digest in _digests(row["artifacts"])}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as err:
        raise DatasetError(
            f"{path}: expected the lock file of a dataset, which names its artifacts, but it cannot be read "
            f"({_reason(err)}); {disk_advice(err, 'remove it, or replace it with a good copy')}."
        ) from err


def _reason(err: Exception) -> str:
    """Return why a lock cannot be read, as the system or the parser says it."""
    if isinstance(err, OSError):
        return err.strerror or str(err)
    return str(err) if isinstance(err, ValueError | DatasetError) else "its entries are not those of a lock"


def _find(path: Path) -> Path:
    if not path.is_dir():
        return path
    if (path / LOCK).is_file():
        return path / LOCK
    below = sorted(path.glob(f"*/{LOCK}"))
    if len(below) == 1:
        return below[0]
    several = f"has several ({', '.join(p.parent.name for p in below)}); name one of these folders"
    raise DatasetError(
        f"{path}: expected a dataset or a lock file, but this folder "
        + (several if below else f"has no {LOCK}")
        + "."
    )


def locked_bag(row: JsonMapping) -> LockedBag:
    """Return a recording from its entry in a lock."""
    needs = _digests(row["artifacts"])
    return LockedBag(row["key"], row["content"], needs[0], row["split"], row["counts"], needs, row)


def _digests(value: object) -> list[str]:
    if not isinstance(value, list) or not value or not all(isinstance(digest, str) for digest in value):
        raise TypeError("artifacts must be a list of digests, the part of the recording first")
    return value
