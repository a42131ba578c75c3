"""Collecting garbage: artifacts that nothing refers to, and what killed processes left.

An artifact keeps the artifacts that it was made from: a lidar sweep its ego poses, a recording's tables their images.
A build that uses a recorded action marks it as used, and a collector moves the record away before it checks
that mark for the last time; so neither can overlook the other.
"""

import json
import os
import socket
from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from uuid import uuid4

from bagassets.base import files
from bagassets.base.errors import StoreError
from bagassets.store.lease import remove_dead_locks
from bagassets.store.store import Store

# An artifact without any record may be about to get one.
_UNRECORDED_S = 86400.0
# Process ids are only unique within one container, so a process that seems dead gets this long.
_DEAD_S = 300.0
# Files in which artifacts name others; read only if the action that made one is not recorded.
_NAMING_FILES = ("channels.json", "files.json")


@dataclass(frozen=True)
class Record:
    """The record of an action that made an artifact."""

    path: Path
    step: str
    artifact: str
    inputs: tuple[str, ...]
    used_s: float


@dataclass(frozen=True)
class Garbage:
    """An artifact that may be removed.

    Attributes:
        artifact: its digest.
        step: the step that made it; empty if that is not recorded.
        size: bytes of its files.
        used_s: when a build made or used it last, in Unix seconds.
        marked_ns: modification time of its folder of files; a build that makes the same artifact again updates it.
        records: records of the actions that made it.
    """

    artifact: str
    step: str
    size: int
    used_s: float
    marked_ns: int
    records: tuple[Path, ...] = ()


@dataclass
class Collected:
    """The result of a collection.

    Attributes:
        removed: the removed artifacts; datasets may still hold some of their files as hard links.
        spared: number of artifacts that a build began to use meanwhile.
        leftovers: number of temporary folders, files and locks of dead processes.
    """

    removed: list[Garbage] = field(default_factory=list)
    spared: int = 0
    leftovers: int = 0


def find_garbage(
    store: Store,
    roots: Collection[str],
    used_since_s: float,
    now_s: float,
    derived: Collection[str] = (),
) -> list[Garbage]:
    """Return the artifacts that nothing refers to, the largest first.

    Args:
        store: the store.
        roots: artifacts that are needed, with all that they were made from.
        used_since_s: artifacts that a build made or used since then are needed, too.
        now_s: the time, in Unix seconds.
        derived: steps whose artifacts are needed as long as what they were made from is.
    """
    records = list(records_in(store))
    by_artifact: dict[str, list[Record]] = {}
    for record in records:
        by_artifact.setdefault(record.artifact, []).append(record)
    recent = {record.artifact for record in records if record.used_s >= used_since_s}
    needed = _closure(store, {*roots, *recent}, by_artifact)
    needed |= {one.artifact for one in records if one.step in derived and not needed.isdisjoint(one.inputs)}
    garbage = []
    for folder in sorted((store.root / "artifacts").glob("*/*")):
        if folder.name in needed:
            continue
        made_by = by_artifact.get(folder.name, [])
        with suppress(FileNotFoundError):  # another collector was faster
            used_s = max((record.used_s for record in made_by), default=folder.stat().st_mtime)
            if not made_by and used_s > min(used_since_s, now_s - _UNRECORDED_S):
                continue
            paths = tuple(record.path for record in made_by)
            step = made_by[0].step if made_by else ""
            marked_ns = _marked_ns(folder)
            size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
            garbage.append(Garbage(folder.name, step, size, used_s, marked_ns, paths))
    return sorted(garbage, key=lambda g: (-g.size, g.artifact))


def collect(store: Store, garbage: Collection[Garbage], now_s: float) -> Collected:
    """Remove leftovers of killed processes and garbage, except what a build began to use since it was found."""
    forgotten = [entry for entry in garbage if _forget(entry)]
    for folder in {record.parent for entry in forgotten for record in entry.records}:
        files.sync_folder(folder)  # a crash must leave no record without its artifact
    removed = [entry for entry in forgotten if _remove(store, entry)]
    collected = Collected(removed, len(garbage) - len(removed), leftovers=remove_dead_locks(store.root))
    collected.leftovers += remove_leftovers(store, now_s)
    for path in (store.root / "actions").glob("*/.*"):  # records that killed processes did not finish
        with suppress(FileNotFoundError):
            if now_s - path.stat().st_mtime > _UNRECORDED_S:
                files.remove(path)
                collected.leftovers += 1
    return collected


def _forget(entry: Garbage) -> bool:
    """Remove the records of an artifact; put them back if one was used since the artifact was found."""
    taken: list[tuple[Path, Path]] = []
    for path in entry.records:
        away = path.with_name(f".{path.name}.{uuid4().hex}")
        with suppress(FileNotFoundError):
            files.move(path, away)
            taken.append((path, away))
    # A build that looks now finds no record. One that looked before has marked it.
    if all(away.stat().st_mtime <= entry.used_s for _, away in taken):
        for _, away in taken:
            files.remove(away)
        return True
    for path, away in taken:
        files.move(away, path)
    return False


def _remove(store: Store, entry: Garbage) -> bool:
    """Remove an artifact, unless a build has just made the same and relies on this one."""
    folder = store.artifact_folder(entry.artifact)
    away = store.make_temporary_folder()
    try:
        files.move(folder, away / entry.artifact)
        if _marked_ns(away / entry.artifact) > entry.marked_ns:
            with suppress(OSError):  # it exists again already
                files.move(away / entry.artifact, folder)
            return False
    except FileNotFoundError:
        return False  # another collector was faster
    finally:
        files.remove_all(away)
    return True


def _marked_ns(folder: Path) -> int:
    """Return when a build that made the same relied on an artifact last; moving a folder does not change its time.

    Builds of before 0.2 mark the folder of the files.
    """
    try:
        return max(folder.stat().st_mtime_ns, (folder / "files").stat().st_mtime_ns)
    except FileNotFoundError:
        return 0  # damaged, so no build relies on it


def _closure(store: Store, roots: Collection[str], by_artifact: Mapping[str, list[Record]]) -> set[str]:
    """Return `roots` and all artifacts that they were made from."""
    needed: set[str] = set()
    waiting = list(roots)
    while waiting:
        artifact = waiting.pop()
        if artifact in needed:
            continue
        needed.add(artifact)
        if artifact in by_artifact:
            waiting += [digest for record in by_artifact[artifact] for digest in record.inputs]
        else:
            waiting += _named_in(store, artifact)
    return needed


def _named_in(store: Store, digest: str) -> set[str]:
    """Return the artifacts that are named in the files of an artifact whose action is not recorded."""
    named: set[str] = set()
    for name in _NAMING_FILES:
        with suppress(StoreError, AttributeError, TypeError, KeyError):
            content = store.artifact(digest).read_json(name)
            rows = content.values() if isinstance(content, dict) else content
            named |= {row["artifact"] for row in rows}
    return named


def records_in(store: Store) -> Iterator[Record]:
    """Yield the records of actions that made artifacts, whether these are there or not."""
    for path in (store.root / "actions").glob("*/*.json"):
        if path.name.startswith(".") or path.name.endswith(".failed.json"):
            continue
        with suppress(OSError, ValueError, KeyError, TypeError, AttributeError):  # torn ones are for `verify`
            record = json.loads(path.read_bytes())
            action = record["action"]
            inputs = tuple(str(digest) for digest in action["inputs"].values())
            yield Record(path, str(action["step"]), str(record["artifact"]), inputs, path.stat().st_mtime)


def remove_leftovers(store: Store, now_s: float) -> int:
    """Remove temporary folders of dead processes, and those of other machines that are a day old; return their number."""
    host, number = socket.gethostname(), 0
    for path in (store.root / "tmp").glob("*"):
        of_host, _, rest = path.name.rpartition("-")[0].rpartition("-")
        is_ours = of_host == host and rest.isdecimal()
        with suppress(OSError):  # it is gone, or of somebody whose files we may not see
            least_s = _DEAD_S if is_ours else _UNRECORDED_S
            if not (is_ours and _is_alive(int(rest))) and now_s - _newest_s(path) > least_s:
                files.remove_all(path)
                number += 1
    return number


def _newest_s(folder: Path) -> float:
    return max([folder.stat().st_mtime, *(path.stat().st_mtime for path in folder.rglob("*"))])


def _is_alive(pid: int) -> bool:
    try:
        with suppress(PermissionError):
            os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True
