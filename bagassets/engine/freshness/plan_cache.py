"""The last plan of each recording, so that the next one examines only those that changed.

Only recordings with nothing to do are kept. A cached plan holds while the fingerprint of the recording and its artifacts
stay the same; otherwise the planner decides. Plans are kept in 256 groups, by their keys: an entry for each recording would
take longer to find and check than to read.
"""

import json
import math
import os
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Literal, NamedTuple
from zlib import crc32

from bagassets.base.cache import Cache, Changes
from bagassets.base.fingerprints import PlanNeeded, Signature, digest_lines, signature
from bagassets.engine.freshness.artifacts import ALL_GROUPS, SIZE, are_unchanged, folders_of, groups_to_check

Checked = Literal["all", "sample", "changed", "fewest"]
_KIND, _FOLDERS = "recordings", "folders"


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
    files: Sequence[Path],
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
    names = [f"{path.name}\0{mark}" for path, mark in marks]
    return RecordingFingerprint(digest_lines(names), records.get("bag"), digest_lines(rest))


class PlanCache:
    """The cached plans of a state folder.

    The artifacts of those that hold are all checked as long as there are few. Of many only those are whose folder in the store
    has gained or lost artifacts since a plan looked at all recordings, and a random sample; see `freshness.artifacts`.

    Args:
        state: the state folder.
        artifacts: folder of the artifacts in the store.
        checked: `all` artifacts in any case; of many a random `sample`, or the `changed` folders alone, as somebody has just
            checked one; or, of few as well, the `fewest`, as somebody is about to check all.
    """

    def __init__(
        self, state: str | os.PathLike[str], artifacts: str | os.PathLike[str], checked: Checked = "all"
    ) -> None:
        self._cache = Cache(state)
        self._artifacts = os.fspath(artifacts)
        self._checked = checked
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
        asked = None if keys is None else frozenset(keys)
        try:
            groups = self._cache.all(_KIND, None if asked is None else {*map(_group_of, asked)})
            plans = (plan for content in groups.values() for plan in _read(content))
            found = {key: plan for key, plan in plans if asked is None or key in asked}
            self._folders_before = json.loads(self._cache.all(_FOLDERS).get("", b"{}"))
        except PlanNeeded:
            return {}
        if self._checked != "all":
            total = others + sum(len(one.made) for one in found.values()) // SIZE
            number, is_sampled = math.inf if self._checked == "fewest" else total, self._checked == "sample"
            self._suspects = groups_to_check(self._folders_before, self._folders, number, sampled=is_sampled)
        return found

    def holds(self, made: bytes) -> bool:
        """Return whether artifacts are as they were noted (`CachedPlan.made`), as far as they are checked."""
        return are_unchanged(self._artifacts, made, self._suspects)

    def save(self, plans: Mapping[str, CachedPlan], gone: Iterable[str]) -> None:
        """Store plans and drop others; if that fails, the next plan examines these recordings.

        Of plans that another process stores in the same group meanwhile, some may be lost.

        Args:
            plans: partition key -> plan.
            gone: partition keys to drop; all others in the cache hold.
        """
        changes, before = Changes(), dict[str, bytes]()
        groups = defaultdict[str, dict[str, CachedPlan | None]](dict)
        for key, plan in {**dict.fromkeys(gone), **plans}.items():
            groups[_group_of(key)][key] = plan
        with suppress(PlanNeeded):  # there are none, then
            before = self._cache.all(_KIND, groups)
        for group, new in groups.items():
            now = {**dict(_read(before.get(group, b""))), **new}
            changes.put(_KIND, group, _written({key: plan for key, plan in now.items() if plan is not None}))
        if self._folders != self._folders_before:
            changes.put(_FOLDERS, "", json.dumps(self._folders).encode())
        self._cache.write(changes)


def _group_of(key: str) -> str:
    return f"{crc32(key.encode()) % 256:02x}"


def _written(plans: Mapping[str, CachedPlan]) -> bytes:
    """Return a group: a line that says what there is, then what is noted of artifacts, and rows, by turns."""
    heads = [[key, *one.fingerprint, len(one.made), len(one.row)] for key, one in plans.items()]
    bodies = (part for one in plans.values() for part in (one.made, one.row))
    return b"".join((json.dumps(heads).encode(), b"\n", *bodies))


def _read(content: bytes) -> Iterator[tuple[str, CachedPlan]]:
    """Inverse of `_written`."""
    line, _, body = content.partition(b"\n")
    at = 0
    for key, files, bag, rest, made, row in json.loads(line or b"[]"):
        begin = at + made
        fingerprint = RecordingFingerprint(files, bag, rest)
        yield key, CachedPlan(fingerprint, body[at:begin], body[begin : (at := begin + row)])
