"""Waiting for another process that makes the same, instead of making it a second time."""

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from bagassets.lock_files import open_lock_file

__all__ = ["underway"]

_FOLDER = "underway"


@contextmanager
def underway(root: Path, action_digest: str) -> Iterator[None]:
    """Hold the lock of an action in the store in `root`, once no other process holds it.

    The system releases it if the process dies. It saves work and keeps nothing right: where the file
    system has no locks, or the folder cannot be written, two processes make the same artifact.
    """
    path = root / _FOLDER / f"{action_digest}.lock"
    descriptor = -1
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor = open_lock_file(path, shared=True)
        fcntl.flock(descriptor, fcntl.LOCK_EX)
    try:
        yield
    finally:
        if descriptor >= 0:
            # Who waits for it has it open; who comes now finds the artifact.
            with suppress(OSError):
                path.unlink()
            os.close(descriptor)
