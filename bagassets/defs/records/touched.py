"""Recordings of which only the time changed: read before any run, and recorded without one.

Somebody copied or touched them, or restored a backup. Their sizes are as recorded, so their content probably is, too; to
read it is cheap beside a run.
"""

import os
import time
from collections.abc import Callable, Generator, Mapping
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from contextlib import closing, suppress
from queue import Empty, SimpleQueue
from threading import Event as Flag
from threading import Lock

import dagster as dg

from bagassets.base.errors import BagAssetsError
from bagassets.base.quantities import count_text, readable_bytes
from bagassets.base.trace import span
from bagassets.defs.records.events import CODE_VERSION, DATA_VERSION
from bagassets.defs.records.instance_plan import Touched
from bagassets.defs.records.reporting import BAG_CODE_VERSION, bag_metadata
from bagassets.defs.records.workspace import Workspace
from bagassets.engine.build_report import Event
from bagassets.engine.first_pass import only_reader
from bagassets.recordings.digest import (
    DigestIndex,
    RecordingDigest,
    RecordingStat,
    recording_digest,
    recording_stat,
)
from bagassets.recordings.model import RecordingFiles
from bagassets.store.store import Store

__all__ = ["record_touched"]

_SHOW_EVERY_S = 0.5
_SHARE_A_PROCESSOR = 4

_Read = tuple[RecordingStat, RecordingDigest, float]  # status before, digest, seconds


def record_touched(
    instance: dg.DagsterInstance,
    workspace: Workspace,
    touched: Mapping[str, Touched],
    jobs: int,
    on_event: Callable[[Event], None],
) -> dict[str, float]:
    """Read recordings that would need a run only because of their time; record those whose content is the same.

    What cannot be read, or changes meanwhile, is left to its run, which reports it.

    Args:
        instance: where `bag` is recorded.
        workspace: recipe, index and recordings.
        touched: see `find_touched`.
        jobs: processors that may be used.
        on_event: called now and then while recordings are read.

    Returns:
        The recordings whose content is the same -> seconds to read it.

    Raises:
        KeyboardInterrupt: the user pressed Ctrl-C; what had been read is recorded.
    """
    if not touched:
        return {}
    # The last first: what is made ahead of a build (`made_ahead`) begins with the first.
    reading = _Reading(
        {key: touched[key].recording for key in reversed(list(touched))}, workspace.index, workspace.store
    )
    same = {}
    with (
        span("read touched", recordings=len(touched)),
        closing(reading.read(jobs, on_event)) as found,
    ):
        for key, stat, digest, seconds in found:
            recording, recorded = touched[key]
            if digest.digest != recorded.data_version:
                continue
            if stat != recorded.stat:
                instance.report_runless_asset_event(
                    dg.AssetMaterialization(
                        workspace.names.key("bag"),
                        description="Recorded without a run: only the time of its files had changed.",
                        partition=recording.key,
                        metadata=bag_metadata(recording, stat, digest),
                        tags={DATA_VERSION: digest.digest, CODE_VERSION: BAG_CODE_VERSION},
                    )
                )
            same[key] = seconds
    return same


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
        self._show_s = time.monotonic() + _SHOW_EVERY_S

    def read(
        self, jobs: int, on_event: Callable[[Event], None]
    ) -> Generator[tuple[str, RecordingStat, RecordingDigest, float], None, None]:
        """Yield key, status before, digest and seconds of each recording that could be read, as soon as it has been."""
        ended: SimpleQueue[Future[_Read]] = SimpleQueue()
        # If all processors may be used, more are read at a time than there are: recordings of one size then end together,
        # where the last one alone would leave processors idle.
        threads = jobs * _SHARE_A_PROCESSOR if jobs >= (os.cpu_count() or 1) > 1 else max(1, jobs)
        with ThreadPoolExecutor(threads) as pool:
            keys = {pool.submit(self._digest, recording): key for key, recording in self._recordings.items()}
            for future in keys:
                future.add_done_callback(ended.put)
            try:
                for _ in keys:
                    future = self._next(ended, on_event)
                    with suppress(BagAssetsError):
                        yield keys[future], *future.result()
            except BaseException:
                self._stopped.set()
                pool.shutdown(wait=False, cancel_futures=True)
                raise

    def _next(self, ended: SimpleQueue[Future[_Read]], on_event: Callable[[Event], None]) -> Future[_Read]:
        """Return the next future that has ended; tell now and then how far all are."""
        while True:
            now_s = time.monotonic()
            if now_s >= self._show_s:
                number = count_text(len(self._recordings), "recording")
                share = min(1.0, self._read / max(1, self._bytes))
                said = f"Reading {number} whose time changed, {readable_bytes(self._bytes)}: {share:.0%}"
                on_event(Event("reading", message=said))
                self._show_s = now_s + _SHOW_EVERY_S
            with suppress(Empty):
                return ended.get(timeout=self._show_s - now_s)

    def _digest(self, recording: RecordingFiles) -> _Read:
        began, stat = time.monotonic(), recording_stat(recording)
        with only_reader(self._store, recording, stat):
            digest = recording_digest(recording, self._index, between=self._note)
        return stat, digest, time.monotonic() - began

    def _note(self, read: int) -> None:
        with self._mutex:
            self._read += read
        if self._stopped.is_set():
            raise CancelledError
