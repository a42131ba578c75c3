"""Files and folders that others see complete or not at all: written beside their final path, and moved there when complete.

Nothing is synced to disk: whoever reads a file must notice if a power loss tore it.
"""

import ctypes
import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

_NO_HARD_LINK = {errno.EPERM, errno.EOPNOTSUPP, errno.ENOSYS, errno.EACCES, errno.EMLINK}
# Linux: arguments of renameat2, and its errors on file systems that cannot do what the flag says.
_AT_FDCWD = -100
_RENAME_NOREPLACE, _RENAME_EXCHANGE = 1, 2
_NO_FLAG = {errno.EINVAL, errno.ENOSYS, errno.EOPNOTSUPP}


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Write a file beside `path` in the block; it replaces `path` if the block succeeds.

    Yields:
        The path to write to, hidden and on the same file system. Nothing is left there in the end.

    Raises:
        OSError: the file cannot be moved into place.
    """
    temporary = _beside(path)
    try:
        yield temporary
        temporary.replace(path)
    except BaseException:
        with suppress(OSError):
            temporary.unlink()
        raise


def write_atomically(path: Path, content: bytes) -> None:
    """Create or replace a file at once, in an existing folder.

    Raises:
        OSError: it cannot be written.
    """
    with replacing(path) as temporary:
        temporary.write_bytes(content)


def create_atomically(path: Path, content: bytes) -> bool:
    """Create a file in an existing folder, unless it exists: the first writer wins, and nobody sees half of it.

    Where the file system has neither hard links nor a rename that replaces nothing, two writers that come at the same
    moment may both count as the first; the file is that of the last.

    Returns:
        True if the file was created, False if it existed before.

    Raises:
        OSError: it cannot be written.
    """
    temporary = _beside(path)
    try:
        temporary.write_bytes(content)
        try:
            os.link(temporary, path)
        except OSError as err:
            if err.errno not in _NO_HARD_LINK:
                raise
            if not _rename(temporary, path, _RENAME_NOREPLACE):
                if path.exists():
                    return False
                temporary.replace(path)
    except FileExistsError:
        return False
    finally:
        with suppress(OSError):
            temporary.unlink()
    return True


def swap_in(new: Path, current: Path) -> Path | None:
    """Put the folder `new` in place of `current`, so that readers see either the old folder or the new one.

    Linux exchanges the two atomically. Elsewhere `current` is renamed away first, and for an instant there is none.

    Returns:
        The path of the old folder, or None if there was none.
    """
    if not current.exists():
        new.rename(current)
        return None
    if _rename(new, current, _RENAME_EXCHANGE):
        return new
    old = current.with_name(f"{new.name}-old-{os.urandom(16).hex()}")
    current.rename(old)
    new.rename(current)
    return old


def _rename(one: Path, other: Path, flag: int) -> bool:
    """Rename with renameat2; return False where the system, or the file system, does not know the flag.

    Raises:
        OSError: it failed.
    """
    try:
        renameat2 = ctypes.CDLL(None, use_errno=True).renameat2
    except (AttributeError, OSError):
        return False
    if renameat2(_AT_FDCWD, os.fsencode(one), _AT_FDCWD, os.fsencode(other), flag) == 0:
        return True
    number = ctypes.get_errno()
    if number in _NO_FLAG:
        return False
    raise OSError(number, os.strerror(number), str(one))


def _beside(path: Path) -> Path:
    """Return a new path on the same file system; its name begins with a dot, so listings hide it."""
    return path.with_name(f".{path.name}.{os.urandom(16).hex()}")
