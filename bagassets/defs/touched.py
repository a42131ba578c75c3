"""Recordings of which only the time changed: read before any run, and recorded without one.

Somebody copied or touched them, or restored a backup. Their sizes are as recorded, so their content probably is, too; to
read it is cheap beside a run.
"""

import time
from collections.abc import Callable, Mapping
from concurrent.futures import CancelledError, ThreadPoolExecutor, wait
from contextlib import suppress
from threading import Event as Flag
from threading import Lock

import dagster as dg

from bagassets.build.build_report import Event
from bagassets.build.first_pass import only_reader
from bagassets.defs.connections import kept_open
from bagassets.defs.events import CODE_VERSION, DATA_VERSION
from bagassets.defs.pending_work import PendingWork
from bagassets.defs.reporting import BAG_CODE_VERSION, bag_metadata
from bagassets.defs.workspace import Workspace
from bagassets.errors import BagAssetsError
from bagassets.quantities import count_text, readable_bytes
from bagassets.recordings.digest import (
    DigestIndex,
    RecordingDigest,
    RecordingStat,
    recording_digest,
    recording_stat,
)
from bagassets.recordings.model import RecordingFiles
from bagassets.store.store import Store
from bagassets.trace import span

__all__ = ["record_touched"]

_NO_RUN = ""  # the run of Dagster's events that belong to none
_SHOW_EVERY_S = 0.5


def record_touched(
    instance: dg.DagsterInstance,
    workspace: Workspace,
    pending: PendingWork,
    jobs: int,
    on_event: Callable[[Event], None],
) -> dict[str, float]:
    """Read the recordings that need a run only because of their time; record those whose content is the same.

    What cannot be read, or changes meanwhile, is left to its run, which reports it.

    Args:
        instance: where `bag` is recorded.
        workspace: recipe, index and recordings.
        pending: what a build has to do.
        jobs: recordings read at the same time.
        on_event: called now and then while recordings are read.

    Returns:
        The recordings whose content is the same -> seconds to read it. Plan again if there are any.

    Raises:
        KeyboardInterrupt: the user pressed Ctrl-C; nothing was recorded that was not read.
    """
    touched = {
        key: pending.planned.recorded[key]["bag"] for key in pending.todo if pending.plan.bags[key].touched
    }
    if not touched:
        return {}
    recordings = pending.planned.discovery.recordings
    # The last first: what is made ahead of a build (`early_inventories`) begins with the first.
    reading = _Reading({key: recordings[key] for key in reversed(touched)}, workspace.index, workspace.store)
    with span("read touched", recordings=len(touched)):
        found = reading.read(jobs, on_event)
    same = {}
    with span("record touched"), kept_open(instance, _NO_RUN):
        for key, (stat, digest, seconds) in found.items():
            if digest.digest != touched[key].data_version:
                continue
            if stat != touched[key].stat:
                _record(instance, workspace.names.key("bag"), recordings[key], stat, digest)
            same[key] = seconds
    return same


def _record(
    instance: dg.DagsterInstance,
    bag: dg.AssetKey,
    recording: RecordingFiles,
    stat: RecordingStat,
    digest: RecordingDigest,
) -> None:
    instance.report_runless_asset_event(
        dg.AssetMaterialization(
            bag,
            description="Recorded without a run: only the time of its files had changed.",
            partition=recording.key,
            metadata=bag_metadata(recording, stat, digest),
            tags={DATA_VERSION: digest.digest, CODE_VERSION: BAG_CODE_VERSION},
        )
    )


class _Reading:
    """Reads recordings, several at a time, and tells how far it is."""

    def __init__(self, recordings: Mapping[str, RecordingFiles], index: DigestIndex, store: Store) -> None:
        self._recordings = recordings
        self._index = index
        self._store = store
        self._bytes = sum(recording.size for recording in recordings.values())
        self._read = 0
        self._mutex = Lock()
        self._stopped = Flag()

    def read(
        self, jobs: int, on_event: Callable[[Event], None]
    ) -> dict[str, tuple[RecordingStat, RecordingDigest, float]]:
        """Return the status before, the digest and the seconds of each recording that could be read."""
        with ThreadPoolExecutor(max(1, jobs)) as pool:
            futures = {
                key: pool.submit(self._digest, recording) for key, recording in self._recordings.items()
            }
            try:
                while wait(futures.values(), _SHOW_EVERY_S).not_done:
                    on_event(Event("reading", message=self._told()))
            except BaseException:
                self._stopped.set()
                pool.shutdown(wait=False, cancel_futures=True)
                raise
        found = {}
        for key, future in futures.items():
            with suppress(BagAssetsError):
                found[key] = future.result()
        return found

    def _digest(self, recording: RecordingFiles) -> tuple[RecordingStat, RecordingDigest, float]:
        began, stat = time.monotonic(), recording_stat(recording)
        with only_reader(self._store, recording, stat):
            digest = recording_digest(recording, self._index, between=self._note)
        return stat, digest, time.monotonic() - began

    def _note(self, read: int) -> None:
        with self._mutex:
            self._read += read
        if self._stopped.is_set():
            raise CancelledError

    def _told(self) -> str:
        number = count_text(len(self._recordings), "recording")
        share = min(1.0, self._read / max(1, self._bytes))
        return f"Reading {number} whose time changed, {readable_bytes(self._bytes)}: {share:.0%}"
