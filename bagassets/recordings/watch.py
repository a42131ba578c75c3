"""The digest service: follows a folder of recordings and keeps a true digest of each file on record.

Notifications of the file system only wake it; changes are found by comparing all names, sizes and times. So nothing is
missed: not among many files at once, not while the service was down, and not where the file system sends no
notifications.
"""

import threading
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from os import stat_result
from pathlib import Path
from typing import Literal

from bagassets.base.errors import BagAssetsError, ChangedWhileReadError, RecordingError
from bagassets.base.fingerprints import Signature, signature_of
from bagassets.recipe.model import Bags
from bagassets.recordings.digest import hash_file
from bagassets.recordings.digest_record import DigestIndex, digest_on_record, disagreements, put_on_record
from bagassets.recordings.discover import discover
from bagassets.recordings.model import RecordingFiles

# However often it is woken, scanning takes at most this share of the time.
_SCAN_SHARE = 0.1
_SHORTEST_PAUSE_S = 0.5
# It ends within this time after it was told to.
_SLICE_S = 0.5
# The first answer comes after this time even without a change; from then on no change is missed.
_FIRST_MS = 500


@dataclass(frozen=True)
class WatchEvent:
    """A report of the service.

    Attributes:
        kind: `hashed`; `wrong` (a record that claimed to hold did not, and was corrected); `problem`
            (a file has no digest until it is solved); `note`.
        message: a sentence.
        path: the file, if the report is about one.
        digest: of a hashed file.
        size: of a hashed file, in bytes.
        seconds: time that hashing took.
    """

    kind: Literal["hashed", "wrong", "problem", "note"]
    message: str
    path: Path | None = None
    digest: str | None = None
    size: int = 0
    seconds: float = 0.0


@dataclass
class _File:
    """What the service remembers about a file.

    Attributes:
        state: as last seen: what shows, without reading it, that it may have changed.
        since_s: when it was first seen in that state, on the monotonic clock.
        settled: the state for which nothing is left to do.
        suspect: no digest on record is trusted; the file must be hashed.
        retry_at_s: when to try again what failed.
    """

    state: Signature
    since_s: float
    settled: Signature | None = None
    suspect: bool = False
    retry_at_s: float | None = None


class _Stopped(Exception):  # noqa: N818  (no error: somebody asked for it)
    """The service was asked to stop while it hashed a file."""


class Notifications:
    """Calls `wake` soon after anything changed below a folder, from a thread of its own.

    Args:
        root: the folder.
        wake: called after changes; many changes at once cause few calls.
        failed: called with the reason if the file system sends no notifications.
    """

    def __init__(self, root: Path, wake: Callable[[], None], failed: Callable[[str], None]) -> None:
        self._root = root
        self._wake = wake
        self._failed = failed
        self._thread: threading.Thread | None = None
        self._stop = threading.Event()
        self._identity: tuple[int, int] | None = None

    def follow(self) -> None:
        """Start, or start anew if the path leads to another folder by now: replaced, or mounted over."""
        try:
            stat = self._root.stat()
        except OSError:
            return  # gone for now; the next call may find it again
        identity = (stat.st_dev, stat.st_ino)
        if self._identity == identity:
            return
        self.close()
        self._identity, self._stop = identity, threading.Event()
        self._thread = threading.Thread(
            target=self._run, args=(self._stop,), name="bagassets-notify", daemon=True
        )
        self._thread.start()

    def close(self) -> None:
        """Stop, and wait for the thread to end."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def _run(self, stop: threading.Event) -> None:
        from watchfiles import watch

        try:
            changes = watch(
                self._root,
                watch_filter=None,
                stop_event=stop,
                raise_interrupt=False,
                ignore_permission_denied=True,
                rust_timeout=_FIRST_MS,
                yield_on_timeout=True,
            )
            established = False
            for batch in changes:
                # Nobody reports changes between the last scan and the first notification: scan once more.
                if batch or not established:
                    self._wake()
                established = True
        except (OSError, RuntimeError) as err:  # the latter from watchfiles, also for too many watches
            self._failed(str(err))


class Watcher:
    """Keeps the digests of all recordings below a folder on record.

    Args:
        bags: where recordings are, which of them count, and how long one must be quiet to be finished.
        index: holds the digests of files that take no extended attributes.
        report: called with everything worth a line in a log.
        rescan_s: how often to scan without being woken.
    """

    def __init__(
        self,
        bags: Bags,
        index: DigestIndex | None,
        report: Callable[[WatchEvent], None],
        *,
        rescan_s: float = 300.0,
    ) -> None:
        self._bags = bags
        self._index = index
        self._report = report
        self._rescan_s = rescan_s
        self._files: dict[Path, _File] = {}
        self._reported: set[str] = set()
        self._wake = threading.Event()
        self._is_stopped = False
        self._suspect_all = False

    def stop(self) -> None:
        """Make `run` return soon; may be called from a signal handler or another thread."""
        self._is_stopped = True

    def run(self, *, verify: bool = False, once: bool = False) -> None:
        """Catch up with what is there, then follow changes until `stop` is called.

        Args:
            verify: first hash everything, and report every digest on record that does not match its file.
            once: return when all finished recordings have their digests.

        Raises:
            RecordingError: the folder is missing at the start.
        """
        self._suspect_all = verify
        due, _ = self._scan()
        self._suspect_all = False
        if once:
            self._hash_all(due)
            return
        with closing(Notifications(self._bags.root, self._wake.set, self._not_notified)) as notifications:
            while not self._is_stopped:
                notifications.follow()
                scanned_at_s = time.monotonic()
                try:
                    due, next_s = self._scan()
                except RecordingError as err:  # the folder is gone, perhaps unmounted: it may come back
                    self._report_once(WatchEvent("problem", str(err), self._bags.root))
                    due, next_s = [], self._rescan_s
                scan_s = time.monotonic() - scanned_at_s
                again_s = scanned_at_s + max(_SHORTEST_PAUSE_S, scan_s / _SCAN_SHARE)
                if self._hash_all(due, scan_again_at_s=again_s):
                    self._wait(scanned_at_s + next_s, self._wake.wait)
                self._wake.clear()
                self._wait(again_s, time.sleep)

    def _wait(self, until_s: float, wait: Callable[[float], bool | None]) -> None:
        """Wait until a time of the monotonic clock, `stop`, or `wait` says that it is over.

        In slices: a signal handler must take no lock, as the thread that it interrupts may hold it, so it can wake nobody.
        """
        while not self._is_stopped and (left_s := until_s - time.monotonic()) > 0:
            if wait(min(left_s, _SLICE_S)):
                return

    # --- scanning -------------------------------------------------------------------------

    def _scan(self) -> tuple[list[RecordingFiles], float]:
        """Scan all files.

        Returns:
            finished recordings that lack a digest, those that have waited longest first, and the seconds until another
            may be finished.
        """
        now_s, wall_s = time.monotonic(), time.time()
        discovery = discover(self._bags, joined=False)  # parts are hashed one by one, as they are finished
        for sentence in discovery.unreadable.values():
            self._report_once(WatchEvent("problem", sentence))
        due: list[tuple[float, str, RecordingFiles]] = []
        seen: dict[Path, _File] = {}
        next_s = self._rescan_s
        for recording in discovery.recordings.values():
            quiet_s, lacking = float("inf"), False
            for path in recording.files:
                try:
                    stat = path.stat()
                except OSError:
                    continue  # removed during the scan
                file = seen[path] = self._seen(path, stat, now_s)
                # A file that has not changed for long is finished already, even if it is new to us.
                quiet_s = min(quiet_s, max(now_s - file.since_s, wall_s - stat.st_ctime_ns / 1e9))
                lacking = lacking or not self._is_settled(path, file, stat, now_s)
            if lacking and quiet_s >= self._bags.settle_s:
                due.append((-quiet_s, recording.relative, recording))
            elif lacking:
                next_s = min(next_s, self._bags.settle_s - quiet_s)
        self._files = seen
        return [recording for _, _, recording in sorted(due, key=lambda entry: entry[:2])], next_s

    def _seen(self, path: Path, stat: stat_result, now_s: float) -> _File:
        state, before = signature_of(stat), self._files.get(path)
        if before is None:
            return _File(state, now_s, suspect=self._suspect_all)
        if before.state == state:
            return before
        # If it changed without a new size or mtime, it may have been edited in place.
        held = before.settled
        in_place = held is not None and held[:2] == state[:2]
        return _File(state, now_s, held, suspect=before.suspect or in_place)

    def _is_settled(self, path: Path, file: _File, stat: stat_result, now_s: float) -> bool:
        """Tell whether nothing is left to do for a file; the digest on record of one new to us is trusted."""
        if file.retry_at_s is not None:
            return now_s < file.retry_at_s
        if file.settled == file.state:
            return True
        if file.suspect or digest_on_record(path, stat, self._index) is None:
            return False
        file.settled = file.state
        return True

    # --- hashing -------------------------------------------------------------------------

    def _hash_all(self, due: list[RecordingFiles], scan_again_at_s: float = float("inf")) -> bool:
        """Hash recordings; return False if a stop or news from the file system interrupted it."""
        for recording in due:
            if self._is_stopped:
                return False
            if self._wake.is_set() and time.monotonic() >= scan_again_at_s:
                return False
            for path in recording.files:
                try:
                    self._hash(path)
                except _Stopped:
                    return False
        return True

    def _hash(self, path: Path) -> None:
        file = self._files.get(path)
        if file is None:
            return
        started_s = time.monotonic()
        try:
            stat = path.stat()
            if file.state != signature_of(stat) or self._is_settled(path, file, stat, started_s):
                return  # done, or changed since the scan: then the next scan sees it
            digest = hash_file(path, stat, self._checkpoint)
            for wrong in disagreements(path, stat, digest, self._index):
                self._report(WatchEvent("wrong", str(wrong), path, digest=digest, size=stat.st_size))
            kept, held = put_on_record(path, stat, digest, self._index)
            if signature_of(path.stat())[:3] != signature_of(stat)[:3]:
                return
        except (ChangedWhileReadError, FileNotFoundError):
            return  # the next scan sees what it has become
        except (BagAssetsError, OSError) as err:
            file.retry_at_s = time.monotonic() + self._rescan_s
            self._report_once(WatchEvent("problem", str(err), path))
            return
        # Writing our attribute changed its ctime; the next scan sees whether it was edited since.
        file.state = file.settled = signature_of(held)
        file.suspect, file.retry_at_s = False, None
        self._reported = {message for message in self._reported if not message.startswith(f"{path}:")}
        seconds = time.monotonic() - started_s
        self._report(
            WatchEvent("hashed", f"{path}: {digest}", path, digest=digest, size=stat.st_size, seconds=seconds)
        )
        if kept == "nowhere":
            self._report_once(
                WatchEvent(
                    "problem",
                    f"{self._bags.root}: digests cannot be stored, because this user cannot write extended attributes "
                    "here; run as a user who may, or name a recipe, whose index takes the digests.",
                )
            )

    def _checkpoint(self, _read: int) -> None:
        if self._is_stopped:
            raise _Stopped

    def _report_once(self, event: WatchEvent) -> None:
        if event.message not in self._reported:
            self._reported.add(event.message)
            self._report(event)

    def _not_notified(self, reason: str) -> None:
        self._report_once(
            WatchEvent(
                "note",
                f"{self._bags.root}: the file system sends no notifications ({reason}), so it is scanned every "
                f"{self._rescan_s:.0f} s; if there are too many folders, raise fs.inotify.max_user_watches.",
                self._bags.root,
            )
        )
