"""Exchanging a folder for another in one step, so that readers see the old or the new one."""

import ctypes
import errno
import os
from pathlib import Path
from uuid import uuid4

__all__ = ["swap_in"]

AT_FDCWD = -100
RENAME_EXCHANGE = 2
_UNSUPPORTED = {errno.EINVAL, errno.ENOSYS, errno.EOPNOTSUPP}


def swap_in(new: Path, current: Path) -> Path | None:
    """Put the folder `new` in the place of `current`.

    Linux exchanges the two atomically. Elsewhere `current` is renamed away first, and for an
    instant there is none.

    Returns:
        where the old folder is now, or None if there was none.
    """
    if not current.exists():
        new.rename(current)
        return None
    if _exchange(new, current):
        return new
    old = current.with_name(f"{new.name}-old-{uuid4().hex}")
    current.rename(old)
    new.rename(current)
    return old


def _exchange(one: Path, other: Path) -> bool:
    """Exchange two paths with renameat2; return False where that does not exist."""
    try:
        renameat2 = ctypes.CDLL(None, use_errno=True).renameat2
    except (AttributeError, OSError):
        return False
    if renameat2(AT_FDCWD, os.fsencode(one), AT_FDCWD, os.fsencode(other), RENAME_EXCHANGE) == 0:
        return True
    number = ctypes.get_errno()
    if number in _UNSUPPORTED:
        return False
    raise OSError(number, os.strerror(number), str(one))
