"""One server per stamp: a lock that the system releases when its holder dies."""

import fcntl
import os
from contextlib import suppress
from pathlib import Path
from typing import Self

from bagassets.forkserver.places import Places

__all__ = ["ServerLock"]


class ServerLock:
    """The lock of one server, held."""

    def __init__(self, path: Path, descriptor: int) -> None:
        self._path = path
        self._descriptor: int | None = descriptor

    @classmethod
    def try_acquire(cls, path: Path) -> Self | None:
        """Return the lock, or None if another process holds it."""
        while True:
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                os.close(descriptor)
                return None
            # The last holder may have removed the file between our open and our lock.
            with suppress(FileNotFoundError):
                if path.stat().st_ino == os.fstat(descriptor).st_ino:
                    return cls(path, descriptor)
            os.close(descriptor)

    def write(self, text: str) -> None:
        """Replace the text of the locked file."""
        self._path.write_text(text, "utf-8")

    def release(self) -> None:
        """Give the lock up and remove its file."""
        if self._descriptor is not None:
            self._path.unlink(missing_ok=True)
            self.close()

    def close(self) -> None:
        """Forget the lock in a forked process; whoever holds it elsewhere keeps it."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None


def remove_leftovers(state_folder: Path) -> None:
    """Remove what servers that were killed left behind."""
    for places in Places.known(state_folder):
        lock = ServerLock.try_acquire(places.lock)
        if lock is not None:
            places.remove_socket()
            places.log.unlink(missing_ok=True)
            lock.release()
