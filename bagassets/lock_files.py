"""Lock files: what processes hold to keep others out, and the system releases when they end, however they end.

Whoever can read a file can lock it, and keep everybody who waits for it waiting for ever. So the files of one user's
project are his alone, and those of folders that users share are for the group that shares them. Where anybody may
put files, a symbolic link in the place of one could name any file of ours: links are refused.
"""

import fcntl
import os
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Self

__all__ = ["LockFile", "is_locked"]

_OWNER, _GROUP = 0o600, 0o660
_FLAGS = os.O_CLOEXEC | os.O_NOFOLLOW


class LockFile:
    """An open lock file; closing it, or leaving its `with` block, releases the lock.

    The lock is that of the open file (`flock`): forked children share it, and it lasts until all have closed it.
    """

    def __init__(self, path: Path, descriptor: int) -> None:
        self._path = path
        self._descriptor: int | None = descriptor

    @classmethod
    def open(cls, path: Path, *, shared: bool = False, new: bool = False) -> Self:
        """Open a lock file, made if need be.

        Args:
            path: the file.
            shared: the group may lock it as well, as far as the umask allows.
            new: there must be none yet.

        Raises:
            OSError: it cannot be opened.
        """
        mode = _GROUP if shared else _OWNER
        flags = os.O_RDWR | os.O_CREAT | _FLAGS | (os.O_EXCL if new else 0)
        descriptor = os.open(path, flags, mode)
        found = os.fstat(descriptor)
        if found.st_mode & 0o777 & ~mode and found.st_uid == os.geteuid():
            os.fchmod(descriptor, found.st_mode & mode)  # made by a version that let others read it
        return cls(path, descriptor)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def lock(self) -> None:
        """Wait until nobody else holds the lock, and hold it.

        Raises:
            OSError: the file system has no locks.
        """
        fcntl.flock(self._open_descriptor, fcntl.LOCK_EX)

    def lock_shared(self) -> None:
        """Wait until nobody holds the lock alone, and hold it beside others who share it.

        Raises:
            OSError: the file system has no locks.
        """
        fcntl.flock(self._open_descriptor, fcntl.LOCK_SH)

    def try_lock(self) -> bool:
        """Hold the lock unless somebody else does; tell whether it is held now.

        Raises:
            OSError: the file system has no locks.
        """
        return _try_lock(self._open_descriptor)

    @property
    def is_in_place(self) -> bool:
        """Return whether the name of the file still leads to it: a holder may have removed it before we locked it."""
        with suppress(FileNotFoundError):
            return os.path.samestat(self._path.stat(), os.fstat(self._open_descriptor))
        return False

    def read(self) -> str:
        """Return what was written into the file, such as who holds it."""
        size = os.fstat(self._open_descriptor).st_size
        return os.pread(self._open_descriptor, size, 0).decode("utf-8", "replace")

    def write(self, text: str) -> None:
        """Replace the text in the file.

        Raises:
            OSError: it cannot be written.
        """
        os.ftruncate(self._open_descriptor, 0)
        os.pwrite(self._open_descriptor, text.encode(), 0)

    def remove(self) -> None:
        """Remove the file and release the lock; nothing is left to do if it was closed.

        Raises:
            OSError: it cannot be removed; the lock is released.
        """
        if self._descriptor is not None:
            try:
                self._path.unlink(missing_ok=True)
            finally:
                self.close()

    def close(self) -> None:
        """Release the lock; a forked process only lets go of its share."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None

    @property
    def _open_descriptor(self) -> int:
        if self._descriptor is None:
            raise ValueError(f"{self._path}: closed")
        return self._descriptor


def is_locked(path: Path) -> bool:
    """Return whether a process holds the lock of a file, whoever made it.

    Raises:
        OSError: that cannot be told: there is no such file, it may not be opened, its file system has no locks.
    """
    try:
        descriptor = os.open(path, os.O_RDWR | _FLAGS)
    except PermissionError:
        # Only its owner may write; for a local lock, reading will do.
        descriptor = os.open(path, os.O_RDONLY | _FLAGS)
    try:
        return not _try_lock(descriptor)
    finally:
        os.close(descriptor)


def _try_lock(descriptor: int) -> bool:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True
