"""Opening lock files so that nobody else on the machine can hold them.

Whoever can read a file can lock it, and keep everybody who waits for it waiting for ever. So the files of one user's
project are his alone, and those of folders that users share are for the group that shares them.
"""

import os
from pathlib import Path

__all__ = ["open_lock_file"]

_OWNER, _GROUP = 0o600, 0o660


def open_lock_file(path: Path, *, shared: bool = False, flags: int = 0) -> int:
    """Open a lock file, made if need be, and return its descriptor.

    Args:
        path: the file.
        shared: the group may lock it as well, as far as the umask allows.
        flags: of `os.open`, besides those to read, write and create.

    Raises:
        OSError: it cannot be opened.
    """
    mode = _GROUP if shared else _OWNER
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | flags, mode)
    found = os.fstat(descriptor)
    if found.st_mode & 0o777 & ~mode and found.st_uid == os.geteuid():
        os.fchmod(descriptor, found.st_mode & mode)  # made by a version that let others read it
    return descriptor
