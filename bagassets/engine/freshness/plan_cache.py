"""The last plan of each recording, so that the next one examines only those that changed.

Only recordings with nothing to do are kept. A cached plan holds while the fingerprint of the recording and its artifacts
stay the same; otherwise the planner decides.
"""

import json
import os
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import NamedTuple

from bagassets.base.cache import Cache, Changes
from bagassets.base.fingerprints import PlanNeeded, Signature, digest_lines, signature
from bagassets.engine.freshness.artifacts import (
    ALL_GROUPS,
    SIZE,
    are_unchanged,
    folders_of,
    groups_to_check,
    note_of,
)

_KIND, _FOLDERS = "recording", "folders"


class RecordingFingerprint(NamedTuple):
    """What changes with everything that the plan of a recording depends on, except artifacts.

    Attributes:
        files: fingerprint of its files, their times and inodes included.
        bag: id of the latest record of `bag` in Dagster; None if there is none.
        rest: fingerprint of the rest: code, recipe, the path of the recording, its label files, records of other assets.
    """

    files: str
    bag: int | None
    rest: str


class CachedPlan(NamedTuple):
    """The plan of a recording with nothing to do.

    Attributes:
        fingerprint: of the recording.
        made: what is noted of the artifacts that it rests on (`freshness.artifacts`).
        row: the plan, encoded.
    """

    fingerprint: RecordingFingerprint
    made: bytes
    row: bytes


def recording_fingerprint(
    project: str,
    relative: str,
    files: Sequence[str | os.PathLike[str]],
    beside: Iterable[str | os.PathLike[str]],
    records: Mapping[str, int],
    seen: Sequence[Signature] = (),
) -> RecordingFingerprint:
    """Return the fingerprint of one recording.

    Args:
        project: fingerprint of the code, the recipe and the files that it names.
        relative: path below the bag root.
        files: the files of the recording.
        beside: its label files, and the paths where they might be.
        records: asset -> id of its latest record in Dagster; empty if the partition does not exist.
        seen: signatures of the files, if they were looked at just now.
    """
    rest = [project, relative]
    rest += [f"{os.fspath(path)}\0{signature(path)}" for path in beside]
    rest += [f"{asset}\0{number}" for asset, number in sorted(records.items()) if asset != "bag"]
    marks = zip(files, seen or map(signature, files), strict=True)
    names = [f"{os.path.basename(path)}\0{mark}" for path, mark in marks]
    return RecordingFingerprint(digest_lines(names), records.get("bag"), digest_lines(rest))


class PlanCache:
    """The cached plans of a state folder.

    The artifacts of those that hold are all checked as long as there are few. Of many only those are whose folder in the store
    has gained or lost artifacts since a plan looked at all recordings, and a random sample; see `freshness.artifacts`.

    Args:
        state: the state folder.
        artifacts: folder of the artifacts in the store.
        thorough: check all artifacts in any case.
    """

    def __init__(
        self, state: str | os.PathLike[str], artifacts: str | os.PathLike[str], *, thorough: bool = True
    ) -> None:
        self._cache = Cache(state)
        self._artifacts = os.fspath(artifacts)
        self._thorough = thorough
        self._folders: dict[str, Signature] = {}
        self._folders_before: dict[str, Signature] = {}
        self._suspects = ALL_GROUPS

    def load(self, keys: Collection[str] | None = None, others: int = 0) -> dict[str, CachedPlan]:
        """Return partition key -> cached plan; empty if the cache cannot be read.

        Args:
            keys: those that are asked for, where the others were looked at just now; default: all.
            others: number of artifacts of these.
        """
        # First: what comes or goes from now on then shows next time.
        self._folders = folders_of(self._artifacts)
        try:
            found = {key: _read(content) for key, content in self._cache.all(_KIND, keys).items()}
            self._folders_before = json.loads(self._cache.all(_FOLDERS).get("", b"{}"))
        except PlanNeeded:
            return {}
        if not self._thorough:
            total = sum(len(one.made) for one in found.values()) // SIZE
            before, sampled = self._folders_before, keys is None
            self._suspects = groups_to_check(before, self._folders, total + others, sampled=sampled)
        return found

    def holds(self, made: bytes) -> bool:
        """Return whether artifacts are as they were noted (`CachedPlan.made`), as far as they are checked."""
        return are_unchanged(self._artifacts, made, self._suspects)

    def save(
        self,
        plans: Mapping[str, tuple[RecordingFingerprint, bytes, Iterable[str]]],
        gone: Iterable[str],
    ) -> None:
        """Store plans and drop others; if that fails, the next plan examines these recordings.

        Args:
            plans: partition key -> fingerprint of the recording, its plan, encoded, and the digests of the artifacts that the
                plan rests on.
            gone: partition keys to drop; all others in the cache hold.
        """
        changes = Changes()
        for key in gone:
            changes.drop(_KIND, key)
        for key, (fingerprint, row, artifacts) in plans.items():
            try:
                made = note_of(self._artifacts, artifacts)
            except PlanNeeded:
                changes.drop(_KIND, key)
            else:
                changes.put(_KIND, key, _written(CachedPlan(fingerprint, made, row)))
        if self._folders != self._folders_before:
            changes.put(_FOLDERS, "", json.dumps(self._folders).encode())
        self._cache.write(changes)


def _written(plan: CachedPlan) -> bytes:
    files, bag, rest = plan.fingerprint
    head = f"{files} {'' if bag is None else bag} {rest} {len(plan.made)}\n".encode()
    return b"".join((head, plan.made, plan.row))


def _read(content: bytes) -> CachedPlan:
    head, _, body = content.partition(b"\n")
    files, bag, rest, size = head.decode().split(" ")
    fingerprint = RecordingFingerprint(files, int(bag) if bag else None, rest)
    return CachedPlan(fingerprint, body[: int(size)], body[int(size) :])
