"""Checking a store: every artifact byte for byte, and that every record leads to one."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from bagassets.store.artifact import MANIFEST, Artifact
from bagassets.store.canonical import digest_bytes, digest_file, digest_json
from bagassets.store.collect import records_in
from bagassets.store.store import Store

# Files above this are hashed block by block, not read at once.
_WHOLE_BYTES = 32 << 20


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


def record_folders(store: Store) -> list[Path]:
    """Return the folders of records of actions."""
    return sorted(store.root.glob("actions/*/"))


def artifacts_in(store: Store) -> Iterator[Artifact]:
    """Yield all artifacts but those that are still being written."""
    folders = sorted(store.root.glob("artifacts/*/*"))
    return (Artifact(folder.name, folder) for folder in folders if folder.name[0] != ".")


def check_records(store: Store, folder: Path, made_by: dict[str, str]) -> Iterator[Damage]:
    """Read one folder of records and yield those that are torn, or whose artifact is gone.

    Args:
        store: the store.
        folder: of `record_folders`.
        made_by: takes artifact -> step that made it.
    """
    for path in sorted(folder.glob("*.json")):
        # What is damaged stays so, unlike a read that failed once.
        if _record_damage(store, path, made_by) and (damage := _record_damage(store, path, made_by)):
            yield damage


def _record_damage(store: Store, path: Path, made_by: dict[str, str]) -> Damage | None:
    name = path.name.partition(".")[0]
    try:
        record = json.loads(path.read_bytes())
        step = str(record["action"]["step"])
        if digest_json(record["action"]) != name:
            return Damage("action", name, ("its record was changed",), step)
        if "artifact" in record:
            made_by[made := str(record["artifact"])] = step
            if not store.artifact_folder(made).is_dir():
                return Damage("action", name, (f"artifact {made[:16]}, which it made, is gone",), step)
        elif "error" not in record:
            return Damage("action", name, ("its record has neither an artifact nor an error",), step)
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError) as err:
        return Damage("action", name, (f"its record cannot be read ({err})",))
    return None


def check_artifact(artifact: Artifact, step: str | None = None) -> Iterator[Damage]:
    """Yield what is wrong with an artifact, if anything is; one that a garbage collector removes meanwhile is not damaged."""
    reasons = artifact_damage(artifact)
    if reasons and artifact.folder.is_dir():
        yield Damage("artifact", artifact.digest, tuple(reasons), step)


def take_out(store: Store, damages: Sequence[Damage]) -> None:
    """Remove what is damaged; artifacts with the records of the actions that made them, which would lead nowhere."""
    artifacts = {damage.digest for damage in damages if damage.kind == "artifact"}
    actions = {damage.digest for damage in damages if damage.kind == "action"}
    if artifacts:
        actions |= {record.path.stem for record in records_in(store) if record.artifact in artifacts}
    for digest in actions:
        store.forget(digest)
    for digest in artifacts:
        store.remove(digest)


def artifact_damage(artifact: Artifact) -> list[str]:
    """Return texts that say what is wrong with an artifact; empty if every byte is as it was written.

    What seems to be damaged is read twice, since a read that failed once is no damage.
    """
    return _damage(artifact) and _damage(artifact)


def _damage(artifact: Artifact) -> list[str]:
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
