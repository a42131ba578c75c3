"""Locks between processes that share a store: leases, and a lock for each running action.

A lease protects what its process uses from the garbage collector. It is a file that the process holds locked; the
system releases it however the process ends. Its modification time is when the process began to use the store. The lock
of an action keeps other processes from making the same artifact a second time.
"""

import os
import socket
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from uuid import uuid4

from bagassets.base import files
from bagassets.base.errors import StoreError
from bagassets.base.lock_files import LockFile, is_locked

_FOLDER, _ACTIONS = "leases", "underway"
# Where the file system has no locks, a lease is valid for this long.
_UNLOCKED_S = 2 * 86400.0
_POLL_S, _LOOK_S = 0.01, 1.0


@contextmanager
def in_use(root: Path) -> Iterator[Path]:
    """Hold a lease on the store in `root`, and yield its file; a process has one, however often it asks.

    Raises:
        StoreError: the store cannot be written.
    """
    place = root.absolute(), os.getpid()
    with _MUTEX:
        lease = _LEASES[place] = _LEASES.get(place) or _take_lease(root)
        _USES[place] += 1
    try:
        yield lease.path
    finally:
        with _MUTEX, suppress(OSError):
            _USES[place] -= 1
            if not _USES[place]:
                _LEASES.pop(place).remove()


def _take_lease(root: Path) -> LockFile:
    path = root / _FOLDER / f"{socket.gethostname()}-{os.getpid()}-{uuid4().hex}"
    try:
        lease = LockFile.open(path, shared=True, new=True)
    except OSError as err:
        raise StoreError(f"{path}: the store cannot be written ({err.strerror}).") from err
    with suppress(OSError):
        lease.lock()
        lease.write(HOLDERS.name)
    # Whoever checked between creating and locking it took it for a dead process's lease and removed it.
    with suppress(OSError):
        files.mark(path)
    return lease


def in_use_since_s(root: Path) -> float | None:
    """Return when the oldest lease was taken (Unix seconds), or None if there is none.

    Leases of dead processes are removed.
    """
    since: list[float] = []
    folder = root / _FOLDER
    for path in folder.iterdir() if folder.is_dir() else ():
        with suppress(FileNotFoundError, PermissionError):
            begun_s = path.stat().st_mtime
            if _is_held(path, begun_s):
                since.append(begun_s)
            else:
                files.remove(path)
    return min(since, default=None)


def _is_held(path: Path, begun_s: float) -> bool:
    try:
        return is_locked(path)
    except FileNotFoundError:
        raise
    except OSError:
        # The file system has no locks, or we may not open the file: nobody can tell.
        return time.time() - begun_s < _UNLOCKED_S


@dataclass
class _Holders:
    """Who holds locks of actions, and whether a holder need not be waited for.

    A worker that was declared dead may be frozen, and hold its locks for ever.

    Attributes:
        name: this process, such as the run that it executes.
        has_ended: whether a holder of that name was given up; asked once a second.
    """

    name: str = ""
    has_ended: Callable[[str], bool] | None = None


HOLDERS = _Holders()
"""Of this process; set by whoever knows."""

_LEASES: dict[tuple[Path, int], LockFile] = {}  # of this process
_USES: Counter[tuple[Path, int]] = Counter()
_MUTEX = threading.Lock()


@contextmanager
def action_lock(root: Path, action_digest: str, on_wait: Callable[[], None] = lambda: None) -> Iterator[None]:
    """Hold the lock of an action in the store in `root`, once no other process holds it that is worth waiting for.

    It is one more name of the lease of its holder, so that no file has to be made for it, and nobody waits for a process
    that died. It only saves work: where the file system has no locks or no hard links, or the folder cannot be written,
    two processes make the same artifact. `on_wait` is called each second of waiting.
    """
    path, is_held = root / _ACTIONS / f"{action_digest}.lock", False
    with ExitStack() as stack:
        with suppress(OSError, StoreError):
            lease = stack.enter_context(in_use(root))
            files.make_folder(path.parent)
            is_held = _linked(lease, path, on_wait)
        try:
            yield
        finally:
            if is_held:
                with suppress(OSError):
                    files.remove(path)  # whoever waits for it sees that; whoever comes now finds the artifact


def _linked(lease: Path, path: Path, on_wait: Callable[[], None]) -> bool:
    """Wait for a lock; return False if its holder was given up.

    Raises:
        OSError: the file system lacks what it takes.
    """
    looked_s = time.monotonic()
    while True:
        with suppress(FileExistsError):
            files.link(lease, path)
            return True
        with LockFile.open(path, shared=True) as other:
            if other.try_lock():  # its holder is dead, or done by now
                if other.is_in_place:
                    files.remove(path)
                continue
            if time.monotonic() - looked_s > _LOOK_S:
                looked_s = time.monotonic()
                on_wait()
                if HOLDERS.has_ended is not None and (holder := other.read()) and HOLDERS.has_ended(holder):
                    return False
        time.sleep(_POLL_S)


def remove_dead_locks(root: Path) -> int:
    """Remove the locks of actions in the store in `root` whose holders are dead, and return their number."""
    number = 0
    for path in (root / _ACTIONS).glob("*.lock"):
        with suppress(OSError), LockFile.open(path, shared=True) as lock:
            if lock.try_lock() and lock.is_in_place:
                number += files.remove(path)
    return number
