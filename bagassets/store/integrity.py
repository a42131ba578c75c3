"""Checking a store: every artifact byte for byte, and that every record leads to one."""

import json
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from bagassets.store.artifact import MANIFEST, Artifact
from bagassets.store.canonical import digest_bytes, digest_file, digest_json
from bagassets.store.store import Store

# Files above this are hashed block by block, not read at once.
_WHOLE_BYTES = 32 << 20

# Digest of an artifact that is gone -> digest and step of the actions that made it.
_Lost = dict[str, list[tuple[str, str]]]


@dataclass(frozen=True)
class Damage:
    """Something damaged in the store.

    Attributes:
        kind: `artifact` (files missing or changed), or `action` (record torn, or its artifact gone).
        digest: digest of the artifact or the action.
        reasons: texts that say what is wrong.
        step: the step that made it, if known.
    """

    kind: Literal["artifact", "action"]
    digest: str
    reasons: tuple[str, ...]
    step: str | None = None

    def __str__(self) -> str:
        of_step = f" of step {self.step}" if self.step else ""
        more = f" (and {len(self.reasons) - 3} more)" if len(self.reasons) > 3 else ""
        return f"{self.kind} {self.digest[:16]}{of_step}: {'; '.join(self.reasons[:3])}{more}"


def check_store(store: Store, progress: Callable[[str], None] | None = None) -> Iterator[Damage]:
    """Read everything in the store and yield what is damaged.

    Nothing is changed. Artifacts that a garbage collector removes meanwhile do not count as damaged.

    Args:
        store: the store.
        progress: called with the digest of each artifact that was checked.
    """
    made_by: dict[str, str] = {}
    lost: _Lost = {}
    for folder in record_folders(store):
        yield from _check_records(store, folder, made_by, lost)
    artifacts = list(artifacts_in(store))
    pool = ThreadPoolExecutor(min(8, os.cpu_count() or 1))
    try:
        for artifact, reasons in zip(artifacts, pool.map(artifact_damage, artifacts), strict=True):
            if reasons and artifact.folder.is_dir():
                lost.pop(artifact.digest, None)
                yield Damage("artifact", artifact.digest, tuple(reasons), made_by.get(artifact.digest))
            if progress is not None:
                progress(artifact.digest)
    finally:
        pool.shutdown(cancel_futures=True)
    yield from _all_lost(lost)


def record_folders(store: Store) -> list[Path]:
    """Return the folders of records of actions."""
    return _folders(store.root / "actions")


def artifacts_in(store: Store) -> Iterator[Artifact]:
    """Yield all artifacts."""
    return (Artifact(folder.name, folder) for folder in _entries(_folders(store.root / "artifacts")))


def check_records(store: Store, folder: Path) -> Iterator[Damage]:
    """Read one folder of records and yield what is damaged, as `check_store` does."""
    lost: _Lost = {}
    yield from _check_records(store, folder, {}, lost)
    yield from _all_lost(lost)


def _check_records(store: Store, folder: Path, made_by: dict[str, str], lost: _Lost) -> Iterator[Damage]:
    """Read records; note which step made which artifact, and of artifacts that are gone the actions that made them."""
    for path in _entries([folder], ".json"):
        name = path.name.partition(".")[0]
        try:
            record = json.loads(path.read_bytes())
            step = str(record["action"]["step"])
            if digest_json(record["action"]) != name:
                yield Damage("action", name, ("its record was changed",), step)
            elif "artifact" in record:
                made = str(record["artifact"])
                made_by[made] = step
                if not store.has(made):
                    lost.setdefault(made, []).append((name, step))
            elif "error" not in record:
                yield Damage("action", name, ("its record has neither an artifact nor an error",), step)
        except FileNotFoundError:
            continue
        except (OSError, ValueError, KeyError, TypeError) as err:
            yield Damage("action", name, (f"its record cannot be read ({err})",))


def _all_lost(lost: _Lost) -> Iterator[Damage]:
    for made, actions in sorted(lost.items()):
        for action, step in actions:
            yield Damage("action", action, (f"artifact {made[:16]}, which it made, is gone",), step)


def artifact_damage(artifact: Artifact) -> list[str]:
    """Return texts that say what is wrong with an artifact; empty if every byte is as it was written."""
    try:
        text = (artifact.folder / MANIFEST).read_bytes()
    except OSError as err:
        return [f"{MANIFEST} cannot be read ({err.strerror})"]
    if digest_bytes(text) != artifact.digest:
        return [f"{MANIFEST} was changed"]
    entries = {entry.path: entry for entry in artifact.entries()}
    reasons = []
    for name, entry in entries.items():
        path = artifact.path(name)
        try:
            size = path.stat().st_size
            if size != entry.size:
                reasons.append(f"{name} has {size} bytes instead of {entry.size}")
            elif _digest(path, size) != entry.digest:
                reasons.append(f"{name} was changed")
        except FileNotFoundError:
            reasons.append(f"{name} is missing")
        except OSError as err:
            reasons.append(f"{name} cannot be read ({err.strerror})")
    for path in artifact.files.rglob("*"):
        name = path.relative_to(artifact.files).as_posix()
        # NFS keeps files that are deleted while in use under such names.
        if name not in entries and not path.name.startswith(".nfs") and not path.is_dir():
            reasons.append(f"{name} does not belong to it")
    return reasons


def _digest(path: Path, size: int) -> str:
    return digest_file(path) if size > _WHOLE_BYTES else digest_bytes(path.read_bytes())


def _folders(folder: Path) -> list[Path]:
    return sorted(part for part in folder.iterdir() if part.is_dir()) if folder.is_dir() else []


def _entries(folders: Iterable[Path], suffix: str = "") -> Iterator[Path]:
    """Yield the entries of folders, by name, without hidden ones, which are still being written."""
    for folder in folders:
        yield from (p for p in sorted(folder.iterdir()) if p.name.endswith(suffix) and p.name[0] != ".")
