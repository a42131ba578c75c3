"""Recordings of which only the time changed: read before any run, and recorded without one.

Somebody copied or touched them, or restored a backup. Their sizes are as recorded, so their content probably is, too; to
read it is cheap beside a run.
"""

import os
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from contextlib import closing, suppress
from queue import Empty, SimpleQueue
from threading import Event as Flag
from threading import Lock

from bagassets.base.errors import BagAssetsError
from bagassets.base.quantities import count_text, readable_bytes
from bagassets.base.trace import span
from bagassets.defs.records.recorder import Made, Recorder
from bagassets.defs.records.reporting import BAG_CODE_VERSION, bag_metadata
from bagassets.defs.records.workspace import Workspace
from bagassets.engine.build_report import Event
from bagassets.engine.first_pass import only_reader
from bagassets.engine.plan import Recorded
from bagassets.recordings.digest import RecordingDigest, RecordingStat, recording_digest, recording_stat
from bagassets.recordings.model import RecordingFiles

_SHOW_EVERY_S = 0.5
_SHARE_A_PROCESSOR = 4

_Read = tuple[RecordingStat, RecordingDigest, float]  # status before, digest, seconds


def record_touched(
    workspace: Workspace,
    touched: Mapping[RecordingFiles, Recorded],
    jobs: int,
    on_event: Callable[[Event], None],
) -> dict[str, float]:
    """Read recordings that would need a run only because of their time; record those whose content is the same.

    What cannot be read, or changes meanwhile, is left to its run, which reports it.

    Args:
        workspace: recipe, index and recordings, and where `bag` is recorded.
        touched: recordings of which only the time seems to have changed -> the latest record of `bag`.
        jobs: processors that may be used.
        on_event: called now and then while recordings are read.

    Returns:
        The recordings whose content is the same -> seconds to read it.

    Raises:
        KeyboardInterrupt: the user pressed Ctrl-C; what had been read is recorded.
    """
    if not touched:
        return {}
    same = {}
    with (
        span("read touched", recordings=len(touched)),
        closing(_read([*touched], workspace, jobs, on_event)) as found,
    ):
        for recording, stat, digest, seconds in found:
            if digest.digest != touched[recording].data_version:
                continue
            if stat != touched[recording].stat:
                about = "Recorded without a run: only the time of its files had changed."
                metadata = bag_metadata(recording, stat, digest)
                made = Made("bag", digest.digest, BAG_CODE_VERSION, metadata, {}, about)
                Recorder(workspace, recording.key).record(made)
            same[recording.key] = seconds
    return same


def _read(
    touched: Sequence[RecordingFiles], workspace: Workspace, jobs: int, on_event: Callable[[Event], None]
) -> Generator[tuple[RecordingFiles, RecordingStat, RecordingDigest, float], None, None]:
    """Yield each recording that could be read, its status before, digest and seconds, as soon as it has been.

    Several are read at a time; now and then `on_event` learns how far all are.
    """
    assets = workspace.assets
    size, read = sum(one.size for one in touched), 0
    mutex, stopped = Lock(), Flag()
    ended: SimpleQueue[Future[_Read]] = SimpleQueue()

    def note(more: int) -> None:
        nonlocal read
        with mutex:
            read += more
        if stopped.is_set():
            raise CancelledError

    def digest_of(recording: RecordingFiles) -> _Read:
        began, stat = time.monotonic(), recording_stat(recording)
        with only_reader(assets.store, recording, stat):
            digest = recording_digest(recording, assets.index, between=note)
        return stat, digest, time.monotonic() - began

    # If all processors may be used, more are read at a time than there are: recordings of one size then end together,
    # where the last one alone would leave processors idle.
    threads = jobs * _SHARE_A_PROCESSOR if jobs >= (os.cpu_count() or 1) > 1 else max(1, jobs)
    with ThreadPoolExecutor(threads) as pool:
        # The last first: what is made ahead of a build (`made_ahead`) begins with the first.
        reads = {pool.submit(digest_of, one): one for one in reversed(touched)}
        for future in reads:
            future.add_done_callback(ended.put)
        left, show_s = len(reads), time.monotonic() + _SHOW_EVERY_S
        try:
            while left:
                if (now_s := time.monotonic()) >= show_s:
                    number = count_text(len(touched), "recording")
                    share = min(1.0, read / max(1, size))
                    said = f"Reading {number} whose time changed, {readable_bytes(size)}: {share:.0%}"
                    on_event(Event("reading", message=said))
                    show_s = now_s + _SHOW_EVERY_S
                with suppress(Empty, BagAssetsError):
                    future = ended.get(timeout=show_s - now_s)
                    left -= 1
                    yield reads[future], *future.result()
        except BaseException:
            stopped.set()
            pool.shutdown(wait=False, cancel_futures=True)
            raise
