"""Lock files, which processes hold to keep others out, and which the system releases however a process ends.

Whoever can read a file can lock it, and keep others waiting for ever. So the lock files of a project are accessible
only to its user, and those of shared folders only to the group that shares them. Where anybody may create files, a
symbolic link in place of a lock file could lead to any file of ours: links are refused.
"""

import fcntl
import os
from contextlib import suppress
from pathlib import Path
from typing import Self

from bagassets.base.files import make_folder, open_lock, remove

RUN_LOCKS = "locks"
"""Folder in the state folder of a project: the locks of recordings that a run works on."""

_OWNER, _GROUP = 0o600, 0o660
_FLAGS = os.O_CLOEXEC | os.O_NOFOLLOW


class LockFile:
    """An open lock file; closing it, or leaving its `with` block, releases the lock.

    The lock belongs to the open file (`flock`): forked children share it, and it lasts until all have closed it.

    Attributes:
        path: the file.
    """

    def __init__(self, path: Path, descriptor: int) -> None:
        self.path = path
        self._descriptor: int | None = descriptor

    @classmethod
    def open(cls, path: Path, *, shared: bool = False, new: bool = False) -> Self:
        """Open a lock file; it, and folders above it, are made if need be.

        Args:
            path: the file.
            shared: True if the group may lock it as well, as far as the umask allows.
            new: True if it must not exist yet.

        Raises:
            OSError: it cannot be opened.
        """
        mode = _GROUP if shared else _OWNER
        flags = os.O_RDWR | os.O_CREAT | _FLAGS | (os.O_EXCL if new else 0)
        make_folder(path.parent)
        descriptor = open_lock(path, flags, mode)
        stat = os.fstat(descriptor)
        if stat.st_mode & 0o777 & ~mode and stat.st_uid == os.geteuid():
            os.fchmod(descriptor, stat.st_mode & mode)  # made by a version that let others read it
        return cls(path, descriptor)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def lock(self) -> None:
        """Wait until nobody else holds the lock, and hold it.

        Raises:
            OSError: the file system has no locks.
        """
        fcntl.flock(self._open_descriptor, fcntl.LOCK_EX)

    def try_lock(self) -> bool:
        """Take the lock unless somebody else holds it; return whether it is held now.

        Raises:
            OSError: the file system has no locks.
        """
        return _try_lock(self._open_descriptor)

    @property
    def is_in_place(self) -> bool:
        """True if the path still leads to this file: a holder may have removed it before we locked it."""
        with suppress(FileNotFoundError):
            return os.path.samestat(self.path.stat(), os.fstat(self._open_descriptor))
        return False

    def read(self) -> str:
        """Return the text in the file, such as the name of its holder."""
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
        """Remove the file and release the lock; does nothing if it was closed.

        Raises:
            OSError: it cannot be removed; the lock is released.
        """
        if self._descriptor is not None:
            try:
                remove(self.path)
            finally:
                self.close()

    def close(self) -> None:
        """Release the lock; in a forked process, only this process's share of it."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None

    @property
    def _open_descriptor(self) -> int:
        if self._descriptor is None:
            raise ValueError(f"{self.path}: closed")
        return self._descriptor


def is_locked(path: Path) -> bool:
    """Return whether a process holds the lock of a file, whoever made it.

    Raises:
        OSError: that is unknown: the file does not exist or may not be opened, or its file system has no locks.
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
