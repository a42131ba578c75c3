"""At most one run per recording at a time, whoever asked for it."""

import fcntl
import hashlib
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from time import sleep

__all__ = ["exclusive"]

_POLL_S = 0.2


@contextmanager
def exclusive(folder: Path, key: str, *, keep_waiting: Callable[[int], bool]) -> Iterator[bool]:
    """Hold the lock `key` of `folder`; the system releases it if this process dies.

    Args:
        folder: where lock files are kept, on a local file system.
        key: name of what must not be worked on twice, such as a partition key.
        keep_waiting: asked five times a second while another process holds the lock, with the
            number of times it was asked before; False gives up.

    Yields:
        True if the lock is held, False if waiting was given up.
    """
    folder.mkdir(parents=True, exist_ok=True)
    name = hashlib.sha256(key.encode()).hexdigest()[:32]
    descriptor = os.open(folder / f"{name}.lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    try:
        asked = 0
        while not (held := _try_lock(descriptor)) and keep_waiting(asked):
            asked += 1
            sleep(_POLL_S)
        yield held
    finally:
        os.close(descriptor)


def _try_lock(descriptor: int) -> bool:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True
