"""Locks that keep runs of the same recording from working at the same time.

They save work, and no more: a network file system may have none, and a worker that was declared dead may hold one. Nobody
waits for a run that has ended, and `fence` keeps that run from recording.
"""

import hashlib
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from math import inf
from pathlib import Path

import dagster as dg
from pydantic import PrivateAttr

from bagassets.base.lock_files import LockFile
from bagassets.defs.records.fence import Fence, run_has_ended
from bagassets.defs.records.run_step import RunStep

_POLL_S = 0.2
ASKS_PER_LOOK = 5
"""How many calls of `keep_waiting` there are in a second, in which one look into the database will do."""
_HELD: set[Path] = set()  # by this process, which would wait for itself otherwise (`flock`)


@contextmanager
def exclusive(
    folder: Path, key: str, *, keep_waiting: Callable[[int], bool], holder: str = ""
) -> Iterator[bool]:
    """Hold the lock `key` of `folder`; the system releases it if this process dies.

    A process that holds it already continues at once.

    Args:
        folder: folder of lock files, on a local file system.
        key: what only one process may work on, such as a partition key.
        keep_waiting: called five times a second while another process holds the lock, with the number of earlier calls;
            False gives up.
        holder: noted in the file, such as a run.

    Yields:
        True if the lock is held, False after giving up, or where the file system has no locks.
    """
    file = _file(folder, key)
    if file in _HELD:
        yield True
        return
    asked = 0
    with LockFile.open(file) as lock:
        try:
            while not (held := lock.try_lock()) and keep_waiting(asked):
                asked += 1
                time.sleep(_POLL_S)
        except OSError:
            held = False
        if held:
            _HELD.add(file)
            with suppress(OSError):
                lock.write(holder)
        try:
            yield held
        finally:
            if held:
                _HELD.discard(file)


def holder_has_ended(instance: dg.DagsterInstance, folder: Path, key: str) -> bool:
    """Return whether nobody need wait for the lock `key`, because the run that holds it has ended."""
    run_id = _holder(folder, key)
    return bool(run_id) and run_has_ended(instance, run_id)


def _holder(folder: Path, key: str) -> str:
    """Return the run that holds a lock, or held it last; "" if that is not known."""
    try:
        return _file(folder, key).read_text("utf-8").strip()
    except (OSError, UnicodeDecodeError):
        return ""


def _file(folder: Path, key: str) -> Path:
    return folder.resolve() / f"{hashlib.sha256(key.encode()).hexdigest()[:32]}.lock"


class RecordingLock(dg.ConfigurableResource):  # type: ignore[type-arg]  # steps get it itself, not a value
    """Keeps runs of one recording from recording or publishing at the same time, whoever launched them.

    For example, a worker that was declared dead may still be working when its successor begins.
    """

    folder: str
    _held: ExitStack = PrivateAttr(default_factory=ExitStack)
    _fences: dict[str, Fence] = PrivateAttr(default_factory=dict)

    def take(self, context: dg.AssetExecutionContext) -> None:
        """Wait until no other run on this machine works on the recording, and hold it until this run ends.

        Raises:
            RunEndedError: this run has ended meanwhile.
        """
        self._held.enter_context(self.hold(RunStep.of(context), context.partition_key))

    @contextmanager
    def hold(self, step: RunStep, key: str) -> Iterator[None]:
        """Wait until no other run on this machine works on a recording, and hold it for a while.

        Raises:
            RunEndedError: this run has ended meanwhile.
        """
        folder = Path(self.folder)

        def keep_waiting(asked: int) -> bool:
            # Where each step is a process, one of this run may hold it, or the worker that waits for all of them; they
            # make nothing twice.
            if _holder(folder, key) == step.run_id:
                return False
            if asked == 0:
                step.log(f"Waiting for another run of {key} to end.")
            # An interrupt raises.
            return bool(asked % ASKS_PER_LOOK) or not holder_has_ended(step.instance, folder, key)

        fence = self._fences.setdefault(step.run_id, Fence(step.instance, step.run_id, -inf))
        with exclusive(folder, key, keep_waiting=keep_waiting, holder=step.run_id):
            fence.check()
            yield

    def teardown_after_execution(self, context: dg.InitResourceContext) -> None:  # noqa: ARG002  (Dagster's)
        """Let the next run begin."""
        self._held.close()
