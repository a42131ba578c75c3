"""Lock files of datasets: what was made from which artifacts."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from bagassets.errors import DatasetError

__all__ = ["LOCK", "DatasetLock", "LockedBag", "load_lock"]

LOCK = "dataset.lock.json"
_FORMAT = 1


@dataclass(frozen=True)
class LockedBag:
    """A recording in a dataset.

    Attributes:
        key: partition key.
        content: digest of the recording.
        artifact: digest of its `nuscenes_tables` or `vision_sequences`.
        split: name of its split.
        scenes: number of its scenes, or of its image sequences.
        samples: number of its keyframes; None in a vision dataset.
    """

    key: str
    content: str
    artifact: str
    split: str
    scenes: int
    samples: int | None


@dataclass(frozen=True)
class DatasetLock:
    """A lock file.

    Attributes:
        path: the file.
        kind: which dataset it is of.
        text: its bytes.
        value: its content.
        bags: the recordings by key, in order.
    """

    path: Path
    kind: Literal["nuscenes", "vision"]
    text: bytes
    value: Mapping[str, Any]
    bags: Mapping[str, LockedBag]

    @property
    def files(self) -> Mapping[str, str]:
        """Digests of the tables, or of the merged files, by name."""
        files: Mapping[str, str] = self.value["tables" if self.kind == "nuscenes" else "files"]
        return files


def load_lock(path: Path) -> DatasetLock:
    """Return a lock file.

    Args:
        path: the file, the folder that it is in, or a dataset with just one.

    Raises:
        DatasetError: there is none, there are several, or it cannot be read.
    """
    found = _find(path.absolute())
    try:
        text = found.read_bytes()
        value = json.loads(text)
        kind: Literal["nuscenes", "vision"] = "vision" if "vision" in value else "nuscenes"
        if value["format"] != _FORMAT:
            raise DatasetError(
                f"{found}: this lock has format {value['format']}, this version of bagassets knows {_FORMAT}; use the "
                "version that wrote it."
            )
        bags = {row["key"]: _bag(row, kind) for row in value["bags"]}
        lock = DatasetLock(found, kind, text, value, dict(sorted(bags.items())))
        lock.files.items()
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as err:
        raise DatasetError(
            f"{found}: expected the lock file of a dataset, but it cannot be read ({type(err).__name__}: {err}); name another."
        ) from err
    return lock


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


def _bag(row: Mapping[str, Any], kind: str) -> LockedBag:
    nuscenes = kind == "nuscenes"
    return LockedBag(
        key=row["key"],
        content=row["content"],
        artifact=row["nuscenes_tables" if nuscenes else "vision_sequences"],
        split=row["split"],
        scenes=row["scenes" if nuscenes else "sequences"],
        samples=row["samples"] if nuscenes else None,
    )
