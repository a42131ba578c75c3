"""Verification in turns: what was read longest ago comes first, as long as there is time.

When each artifact, folder of records and recording was last found whole is kept beside them. It may be lost: then they
count as never verified.
"""

import json
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from hashlib import blake2b
from operator import itemgetter
from pathlib import Path
from typing import NamedTuple

from bagassets.base.atomic import write_atomically
from bagassets.base.quantities import count_text, readable_bytes
from bagassets.engine.recording_assets import RecordingAssets
from bagassets.engine.recordings_check import CheckedRecording, check_recording
from bagassets.recordings.digest_record import DigestIndex
from bagassets.recordings.discover import discover
from bagassets.recordings.model import RecordingFiles
from bagassets.store.artifact import Artifact
from bagassets.store.integrity import Damage, artifact_damage, artifacts_in, check_records, record_folders
from bagassets.store.store import Store

RECENT_DAYS = 30
_DAY_S = 86_400.0
_SAVE_S = 10.0  # so much is verified again after a kill
_NAME = "verified.json"


class Verified:
    """When things in a folder were last found whole.

    Attributes:
        problem: why that cannot be noted; None if it can.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / _NAME
        self._new: dict[str, int] = {}
        self._times = self._read()
        self._saved_s = time.monotonic()
        self.problem: str | None = None

    def _read(self) -> dict[str, int]:
        with suppress(OSError, ValueError, TypeError, AttributeError):
            now_s = time.time()
            times = {str(name): int(at) for name, at in json.loads(self._path.read_bytes()).items()}
            return {name: at for name, at in times.items() if at <= now_s}  # a clock was wrong
        return {}

    def time_s(self, name: str) -> int:
        """Return when something was last found whole, in seconds since 1970; 0 for never."""
        return self._times.get(name, 0)

    def is_recent(self, name: str) -> bool:
        """Tell whether that was within the last 30 days."""
        return self.time_s(name) > time.time() - RECENT_DAYS * _DAY_S

    def note(self, name: str) -> None:
        """Note that something was found whole just now."""
        self._times[name] = self._new[name] = int(time.time())

    def save(self, names: Iterable[str], *, now: bool = True) -> None:
        """Write what was noted, and forget all but `names`; unless it must be `now`, every ten seconds only."""
        if not self._new or (not now and time.monotonic() < self._saved_s + _SAVE_S):
            return
        times = self._read() | self._new  # another process may have verified other things
        kept = {name: times[name] for name in sorted(names) if name in times}
        try:
            write_atomically(self._path, json.dumps(kept, indent=0).encode())
        except OSError as err:
            self.problem = f"{self._path}: it cannot be noted what was verified ({err.strerror})"
        self._saved_s = time.monotonic()


def note_store(store: Store, artifacts: Sequence[str], damages: Sequence[Damage]) -> None:
    """Note that a whole store was verified: all its records and these artifacts, but for what is damaged."""
    verified, damaged = Verified(store.root), {damage.digest for damage in damages}
    torn = {damage.digest[:2] for damage in damages if damage.kind == "action"}
    folders = [folder.name for folder in record_folders(store) if folder.name not in torn]
    for name in (*folders, *artifacts):
        if name not in damaged:
            verified.note(name)
    verified.save((*folders, *artifacts))


_Subject = Artifact | Path | RecordingFiles


class Turn(NamedTuple):
    """An artifact, folder of records or recording that was verified, and what was found."""

    what: _Subject
    damages: list[Damage]
    recording: CheckedRecording | None

    @property
    def is_whole(self) -> bool:
        """True if every byte was compared with what is on record, and is right."""
        return not self.damages and (self.recording is None or self.recording.is_verified)


class Turns:
    """What can be verified of a store and recordings, and how much of it was.

    Args:
        assets: the assets of a recording under the recipe.
        store: the artifact store.
        with_store: not of recordings alone.

    Raises:
        RecordingError: the bag root is not there.
    """

    def __init__(self, assets: RecordingAssets, store: Store, *, with_store: bool) -> None:
        self._assets, self._store, self._index = assets, store, DigestIndex.of(assets.recipe)
        recordings = discover(assets.recipe.bags).recordings.values()
        self._of_recordings = Verified(assets.recipe.state), {name_of(one): one for one in recordings}
        self._in_store: tuple[Verified, dict[str, Artifact | Path]] = Verified(store.root), {}
        if with_store:
            self._in_store[1].update({one.name: one for one in record_folders(store)})
            self._in_store[1].update({one.digest: one for one in artifacts_in(store)})

    def run(self, most_s: float) -> Iterator[Turn]:
        """Verify one after the other, the oldest first; one is begun no later than after `most_s`, and one at least.

        Nothing is changed but what is noted of those that were found whole.
        """
        end_s = time.monotonic() + most_s
        found = [
            (verified.time_s(name), _mixed(name), verified, name, what)
            for verified, all_of_them in (self._in_store, self._of_recordings)
            for name, what in all_of_them.items()
        ]
        try:
            for _, _, verified, name, what in sorted(found, key=itemgetter(0, 1)):
                turn = self._verify(what)
                if turn.is_whole:
                    verified.note(name)
                yield turn
                self._save(now=False)
                if time.monotonic() >= end_s:
                    return
        finally:
            self._save(now=True)

    def _verify(self, what: _Subject) -> Turn:
        if isinstance(what, Path):
            return Turn(what, list(check_records(self._store, what)), None)
        if isinstance(what, RecordingFiles):
            return Turn(what, [], check_recording(self._assets, self._store, self._index, what))
        reasons = artifact_damage(what)
        is_there = what.folder.is_dir()  # else it was collected meanwhile
        return Turn(
            what, [Damage("artifact", what.digest, tuple(reasons))] if reasons and is_there else [], None
        )

    def _save(self, *, now: bool) -> None:
        for verified, names in (self._in_store, self._of_recordings):
            verified.save(names, now=now)

    @property
    def problems(self) -> list[str]:
        """Sentences that say why it cannot be noted what was verified."""
        both = (self._in_store[0].problem, self._of_recordings[0].problem)
        return [problem for problem in both if problem is not None]

    def share(self) -> dict[str, int]:
        """Return how much was verified within the last 30 days, and of how much."""
        verified, in_store = self._in_store
        artifacts = [name for name, one in in_store.items() if isinstance(one, Artifact)]
        of_recordings, recordings = self._of_recordings
        recent = [one.size for name, one in recordings.items() if of_recordings.is_recent(name)]
        return {
            "days": RECENT_DAYS,
            "artifacts": sum(map(verified.is_recent, artifacts)),
            "of_artifacts": len(artifacts),
            "recordings": len(recent),
            "of_recordings": len(recordings),
            "recording_bytes": sum(recent),
            "of_recording_bytes": sum(one.size for one in recordings.values()),
        }


def share_text(share: Mapping[str, int]) -> str:
    """Return in words how much was verified."""
    return (
        f"Verified within {share['days']} days: {share['artifacts']} of {count_text(share['of_artifacts'], 'artifact')}, "
        f"{share['recordings']} of {count_text(share['of_recordings'], 'recording')} "
        f"({readable_bytes(share['recording_bytes'])} of {readable_bytes(share['of_recording_bytes'])})."
    )


def name_of(recording: RecordingFiles) -> str:
    """Return what stands for a recording and its bytes: one that is written to counts as never verified."""
    return f"{recording.key} {recording.size} {recording.mtime_ns}"


def _mixed(name: str) -> bytes:
    """Of what is equally old, store and recordings take turns."""
    return blake2b(name.encode()).digest()
