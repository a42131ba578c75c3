"""Locks that keep runs of the same recording from working at the same time."""

import hashlib
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from time import sleep

import dagster as dg
from pydantic import PrivateAttr

from bagassets.lock_files import LockFile

__all__ = ["RecordingLock", "exclusive"]

_POLL_S = 0.2
_HELD: set[Path] = set()  # by this process, which would wait for itself otherwise (`flock`)


@contextmanager
def exclusive(folder: Path, key: str, *, keep_waiting: Callable[[int], bool]) -> Iterator[bool]:
    """Hold the lock `key` of `folder`; the system releases it if this process dies.

    A process that holds it already continues at once.

    Args:
        folder: folder of lock files, on a local file system.
        key: what only one process may work on, such as a partition key.
        keep_waiting: called five times a second while another process holds the lock, with the number of earlier calls;
            False gives up.

    Yields:
        True if the lock is held, False after giving up.
    """
    file = folder.resolve() / f"{hashlib.sha256(key.encode()).hexdigest()[:32]}.lock"
    if file in _HELD:
        yield True
        return
    folder.mkdir(parents=True, exist_ok=True)
    asked = 0
    with LockFile.open(file) as lock:
        while not (held := lock.try_lock()) and keep_waiting(asked):
            asked += 1
            sleep(_POLL_S)
        if held:
            _HELD.add(file)
        try:
            yield held
        finally:
            if held:
                _HELD.discard(file)


class RecordingLock(dg.ConfigurableResource):  # type: ignore[type-arg]  # steps get it itself, not a value
    """Keeps runs of one recording from recording or publishing at the same time, whoever launched them.

    For example, a worker that was declared dead may still be working when its successor begins.
    """

    folder: str
    _held: ExitStack = PrivateAttr(default_factory=ExitStack)

    def take(self, context: dg.AssetExecutionContext) -> None:
        """Wait until no other run on this machine works on the recording, and hold it until this run ends."""

        def keep_waiting(asked: int) -> bool:
            if asked == 0:
                context.log.info("Waiting for another run of %s to end.", context.partition_key)
            return True  # an interrupt raises

        self._held.enter_context(
            exclusive(Path(self.folder), context.partition_key, keep_waiting=keep_waiting)
        )

    def teardown_after_execution(self, context: dg.InitResourceContext) -> None:  # noqa: ARG002  (Dagster's)
        """Let the next run begin."""
        self._held.close()
