"""Verification in turns: what was read longest ago comes first, as long as there is time.

When each artifact, folder of records and recording was last found whole is kept beside them. It may be lost: then they
count as never verified.
"""

import json
import math
import os
import time
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from hashlib import blake2b
from itertools import groupby, islice
from pathlib import Path

from bagassets.base.files import write_atomically
from bagassets.base.quantities import count_text, readable_bytes
from bagassets.engine.recording_assets import RecordingAssets
from bagassets.engine.recordings_check import CheckedRecording, check_recording
from bagassets.recordings.discover import discover
from bagassets.store.integrity import Damage, artifacts_in, check_artifact, check_records, record_folders

RECENT_DAYS = 30
_SAVE_S = 10.0  # so much is verified again after a kill
_THREADS = min(8, os.cpu_count() or 1)


class Verified:
    """When things in a folder were last found whole.

    Attributes:
        times: name -> seconds since 1970.
        problem: why that cannot be noted; "" if it can.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / "verified.json"
        self._new: dict[str, int] = {}
        self.times, self.problem, self._saved_s = self._read(), "", time.monotonic()

    def _read(self) -> dict[str, int]:
        with suppress(OSError, ValueError, TypeError, AttributeError):
            times = {str(name): int(at) for name, at in json.loads(self._path.read_bytes()).items()}
            return {name: at for name, at in times.items() if at <= time.time()}  # else a clock was wrong
        return {}

    def recent(self, names: Iterable[str]) -> list[str]:
        """Return those of `names` that were found whole within the last 30 days."""
        since_s = time.time() - RECENT_DAYS * 86_400
        return [name for name in names if self.times.get(name, 0) > since_s]

    def note(self, name: str, *, is_whole: bool) -> None:
        """Note whether something was found whole just now; if not, it counts as never verified."""
        self.times[name] = self._new[name] = int(time.time()) if is_whole else 0

    def save(self, names: Iterable[str], *, now: bool = True) -> None:
        """Write what was noted, and forget all but `names`; unless it must be `now`, every ten seconds only."""
        if not self._new or (not now and time.monotonic() < self._saved_s + _SAVE_S):
            return
        times = self._read() | self._new  # another process may have verified other things
        kept = {name: times[name] for name in sorted(names) if times.get(name)}
        try:
            write_atomically(self._path, json.dumps(kept, indent=0).encode())
        except OSError as err:
            self.problem = f"{self._path}: it cannot be noted what was verified ({err.strerror})"
        self._saved_s = time.monotonic()


class Turns:
    """What can be verified of a store and recordings, and how much of it was.

    Args:
        assets: the assets of a recording under the recipe.
        with_store: verify the artifacts of the store, and records of actions.
        with_recordings: verify recordings.

    Attributes:
        artifacts: digest -> artifact.
        notes: when what is in the store, and recordings, were last found whole.

    Raises:
        RecordingError: the bag root is not there.
    """

    def __init__(self, assets: RecordingAssets, *, with_store: bool, with_recordings: bool) -> None:
        self._assets, self._store = assets, assets.store
        recordings = discover(assets.recipe.bags).recordings.values() if with_recordings else ()
        # One that is written to has another name, and counts as never verified.
        self._recordings = {f"{one.key} {one.size} {one.mtime_ns}": one for one in recordings}
        self.artifacts = {one.digest: one for one in artifacts_in(self._store)} if with_store else {}
        self._folders = {one.name: one for one in record_folders(self._store)} if with_store else {}
        self._in_store = (*self._folders, *self.artifacts)
        self._made_by: dict[str, str] = {}
        self.notes = self._stored, self._recorded = Verified(self._store.root), Verified(assets.recipe.state)

    def run(self, most_s: float = math.inf) -> Iterator[list[Damage] | CheckedRecording]:
        """Verify one after the other, the oldest first if there is little time, and yield what was found.

        None is begun after `most_s`, but one at least is verified. Nothing is changed but what is noted of them.
        """
        end_s = time.monotonic() + most_s
        names = dict.fromkeys(self._in_store, self._stored)
        names |= dict.fromkeys(self._recordings, self._recorded)
        # Of what is equally old, store and recordings take turns.
        ages = {name: (names[name].times.get(name, 0), blake2b(name.encode()).digest()) for name in names}
        order = sorted(names, key=ages.__getitem__) if most_s < math.inf else list(names)
        try:
            for name, found in self._results(order, end_s):
                is_whole = not found if isinstance(found, list) else found.is_sound and not found.unrecorded
                names[name].note(name, is_whole=is_whole)
                yield found
                self._save(now=False)
        finally:
            self._save(now=True)

    def _results(
        self, names: Sequence[str], end_s: float
    ) -> Iterator[tuple[str, list[Damage] | CheckedRecording]]:
        """Yield what is found: artifacts are read side by side, some at a time."""
        with ThreadPoolExecutor(_THREADS) as pool:
            for are_artifacts, alike in groupby(names, self.artifacts.__contains__):
                while some := list(islice(alike, _THREADS if are_artifacts else 1)):
                    # An interrupt need not wait for a recording.
                    side_by_side = pool.map if are_artifacts else map
                    yield from zip(some, side_by_side(self._verify, some), strict=True)
                    if time.monotonic() >= end_s:
                        return

    def _verify(self, name: str) -> list[Damage] | CheckedRecording:
        if name in self._recordings:
            return check_recording(self._assets, self._recordings[name])
        if name in self._folders:
            return list(check_records(self._store, self._folders[name], self._made_by))
        return list(check_artifact(self.artifacts[name], self._made_by.get(name)))

    def _save(self, *, now: bool) -> None:
        self._stored.save(self._in_store, now=now)
        self._recorded.save(self._recordings, now=now)

    def share(self) -> dict[str, int]:
        """Return how much was verified within the last 30 days, and of how much."""
        recent = [self._recordings[name].size for name in self._recorded.recent(self._recordings)]
        return {
            "days": RECENT_DAYS,
            "artifacts": len(self._stored.recent(self.artifacts)),
            "of_artifacts": len(self.artifacts),
            "recordings": len(recent),
            "of_recordings": len(self._recordings),
            "recording_bytes": sum(recent),
            "of_recording_bytes": sum(one.size for one in self._recordings.values()),
        }

    def share_text(self) -> str:
        """Return how much was verified as one sentence."""
        share = self.share()
        stored = f"{share['artifacts']} of {count_text(share['of_artifacts'], 'artifact')}, "
        return (
            f"Verified within {RECENT_DAYS} days: {stored if self._in_store else ''}{share['recordings']} of {count_text(share['of_recordings'], 'recording')} "
            f"({readable_bytes(share['recording_bytes'])} of {readable_bytes(share['of_recording_bytes'])})."
        )
