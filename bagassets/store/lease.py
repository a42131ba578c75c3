"""Who works with a store right now, so that nobody removes what they use.

A lease is a file that its process holds locked: the system releases it when the process ends, however it
ends. Its time says since when the process has been at work.
"""

import os
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from uuid import uuid4

from bagassets.errors import StoreError
from bagassets.lock_files import LockFile, is_locked

__all__ = ["in_use", "in_use_since_s"]

_FOLDER = "leases"
# Where the file system has no locks, a lease counts for so long.
_UNLOCKED_S = 2 * 86400.0


@contextmanager
def in_use(root: Path) -> Iterator[None]:
    """Hold a lease on the store in `root`.

    Raises:
        StoreError: the store cannot be written.
    """
    folder = root / _FOLDER
    path = folder / f"{socket.gethostname()}-{os.getpid()}-{uuid4().hex}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lease = LockFile.open(path, shared=True, new=True)
    except OSError as err:
        raise StoreError(f"{path}: the store cannot be written ({err.strerror}).") from err
    try:
        with suppress(OSError):
            lease.lock()
        # Whoever looked between these two steps took it for that of a dead process.
        with suppress(OSError):
            path.touch()
        yield
    finally:
        with suppress(OSError):
            lease.remove()


def in_use_since_s(root: Path) -> float | None:
    """Return since when the longest at work has been so, in Unix seconds; None if nobody is.

    Leases of processes that are no more are removed.
    """
    since: list[float] = []
    folder = root / _FOLDER
    for path in folder.iterdir() if folder.is_dir() else ():
        with suppress(FileNotFoundError, PermissionError):
            begun_s = path.stat().st_mtime
            if _is_held(path, begun_s):
                since.append(begun_s)
            else:
                path.unlink()
    return min(since, default=None)


def _is_held(path: Path, begun_s: float) -> bool:
    try:
        return is_locked(path)
    except FileNotFoundError:
        raise
    except OSError:
        # No locks here, or a user who shares the store but not the group's files: nobody can tell.
        return time.time() - begun_s < _UNLOCKED_S
