"""What the last plan found of each recording, so that the next one looks only into those that changed.

Only recordings with nothing to do are remembered. What is remembered counts while the recording has the same mark, and
its artifacts have: else the planner is asked.
"""

import json
import os
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

from bagassets.freshness.artifacts import artifacts_mark, packed
from bagassets.freshness.cache import Cache, Changes
from bagassets.freshness.marks import Doubt, digest, signature

__all__ = ["Memory", "Remembered", "recording_mark"]

_KIND = "recording"


class Remembered(NamedTuple):
    """A recording with nothing to do, as it was.

    Attributes:
        mark: of the recording.
        artifacts: mark of its artifacts.
        plan: its plan, as JSON.
    """

    mark: str
    artifacts: str
    plan: Any


def recording_mark(
    project: str,
    relative: str,
    files: Iterable[str | os.PathLike[str]],
    beside: Iterable[str | os.PathLike[str]],
    records: Mapping[str, int],
) -> str:
    """Return the mark of one recording: of everything but artifacts that its plan is decided from.

    Args:
        project: mark of code, recipe and the files that it names.
        relative: path below the bag root.
        files: the files of the recording.
        beside: its label files, and where they might be.
        records: asset -> id of what Dagster recorded last; nothing if its partition is not alive.
    """
    lines = [project, relative]
    lines += [f"{os.path.basename(path)}\0{signature(path)}" for path in files]
    lines.append("beside")
    lines += [f"{os.fspath(path)}\0{signature(path)}" for path in beside]
    lines += [f"{asset}\0{number}" for asset, number in sorted(records.items())]
    return digest(lines)


class Memory:
    """What is remembered of recordings.

    Args:
        state: the state folder.
        artifacts: folder of the artifacts in the store.
    """

    def __init__(self, state: str | os.PathLike[str], artifacts: str | os.PathLike[str]) -> None:
        self._cache = Cache(state)
        self._artifacts = os.fspath(artifacts)

    def load(self) -> dict[str, Remembered]:
        """Return partition key -> what is remembered; nothing if it cannot be read."""
        try:
            return {key: Remembered(*json.loads(text)) for key, text in self._cache.all(_KIND).items()}
        except Doubt:
            return {}

    def holds(self, entry: Remembered, artifacts: Iterable[str]) -> bool:
        """Tell whether the artifacts of a recording are as they were."""
        try:
            return artifacts_mark(self._artifacts, packed(artifacts)) == entry.artifacts
        except Doubt:
            return False

    def save(self, found: Mapping[str, tuple[str, Any, Iterable[str]]], gone: Iterable[str]) -> None:
        """Remember recordings and forget others; where that cannot be, the next plan looks into them.

        Args:
            found: partition key -> mark, plan as JSON, and digests of the artifacts that it rests on.
            gone: partition keys to forget.
        """
        changes = Changes()
        for key in gone:
            changes.drop(_KIND, key)
        for key, (mark, plan, artifacts) in found.items():
            try:
                entry = [mark, artifacts_mark(self._artifacts, packed(artifacts)), plan]
            except Doubt:
                changes.drop(_KIND, key)
            else:
                changes.put(_KIND, key, json.dumps(entry, separators=(",", ":")).encode())
        self._cache.write(changes)
