"""The last plan of each recording, so that the next one examines only those that changed.

Only recordings with nothing to do are kept. A cached plan holds while the fingerprints of the recording and of its
artifacts stay the same; otherwise the planner decides.
"""

import json
import os
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

from bagassets.base.cache import Cache, Changes
from bagassets.base.fingerprints import PlanNeeded, digest_lines, signature
from bagassets.engine.freshness.artifacts import artifacts_fingerprint, packed

_KIND = "recording"


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
        recording_fingerprint: fingerprint of the recording.
        artifacts_fingerprint: fingerprint of its artifacts.
        plan: the plan, as JSON.
    """

    recording_fingerprint: RecordingFingerprint
    artifacts_fingerprint: str
    plan: Any


def recording_fingerprint(
    project: str,
    relative: str,
    files: Iterable[str | os.PathLike[str]],
    beside: Iterable[str | os.PathLike[str]],
    records: Mapping[str, int],
) -> RecordingFingerprint:
    """Return the fingerprint of one recording.

    Args:
        project: fingerprint of the code, the recipe and the files that it names.
        relative: path below the bag root.
        files: the files of the recording.
        beside: its label files, and the paths where they might be.
        records: asset -> id of its latest record in Dagster; empty if the partition does not exist.
    """
    rest = [project, relative]
    rest += [f"{os.fspath(path)}\0{signature(path)}" for path in beside]
    rest += [f"{asset}\0{number}" for asset, number in sorted(records.items()) if asset != "bag"]
    names = [f"{os.path.basename(path)}\0{signature(path)}" for path in files]
    return RecordingFingerprint(digest_lines(names), records.get("bag"), digest_lines(rest))


class PlanCache:
    """The cached plans of a state folder.

    Args:
        state: the state folder.
        artifacts: folder of the artifacts in the store.
    """

    def __init__(self, state: str | os.PathLike[str], artifacts: str | os.PathLike[str]) -> None:
        self._cache = Cache(state)
        self._artifacts = os.fspath(artifacts)

    def load(self) -> dict[str, CachedPlan]:
        """Return partition key -> cached plan; empty if the cache cannot be read."""
        try:
            entries = {key: json.loads(text) for key, text in self._cache.all(_KIND).items()}
        except PlanNeeded:
            return {}
        return {
            key: CachedPlan(RecordingFingerprint(*fingerprint), artifacts, plan)
            for key, (fingerprint, artifacts, plan) in entries.items()
        }

    def holds(self, entry: CachedPlan, artifacts: Iterable[str]) -> bool:
        """Return whether the artifacts of a recording are unchanged."""
        try:
            now = artifacts_fingerprint(self._artifacts, packed(artifacts))
        except PlanNeeded:
            return False
        return now == entry.artifacts_fingerprint

    def save(
        self, plans: Mapping[str, tuple[RecordingFingerprint, Any, Iterable[str]]], gone: Iterable[str]
    ) -> None:
        """Store plans and drop others; if that fails, the next plan examines these recordings.

        Args:
            plans: partition key -> fingerprint of the recording, its plan as JSON, and the digests of the artifacts
                that the plan rests on.
            gone: partition keys to drop.
        """
        changes = Changes()
        for key in gone:
            changes.drop(_KIND, key)
        for key, (fingerprint, plan, artifacts) in plans.items():
            try:
                entry = [fingerprint, artifacts_fingerprint(self._artifacts, packed(artifacts)), plan]
            except PlanNeeded:
                changes.drop(_KIND, key)
            else:
                changes.put(_KIND, key, json.dumps(entry, separators=(",", ":")).encode())
        self._cache.write(changes)
