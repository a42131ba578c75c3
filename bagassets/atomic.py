"""Files that others see complete or not at all: written beside their final path, and moved there when complete.

Nothing is synced to disk: whoever reads a file must notice if a power loss tore it.
"""

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

__all__ = ["create_atomically", "replacing", "write_atomically"]

_NO_HARD_LINK = {errno.EPERM, errno.EOPNOTSUPP, errno.ENOSYS, errno.EACCES, errno.EMLINK}


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
    """Create or replace a file in one step, in an existing folder.

    Raises:
        OSError: it cannot be written.
    """
    with replacing(path) as temporary:
        temporary.write_bytes(content)


def create_atomically(path: Path, content: bytes) -> bool:
    """Create a file in an existing folder, unless it exists: the first writer wins.

    Where the file system has no hard links, that is not one step, and the file may be torn.

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
            with path.open("xb") as file:
                file.write(content)
    except FileExistsError:
        return False
    finally:
        with suppress(OSError):
            temporary.unlink()
    return True


def _beside(path: Path) -> Path:
    """Return a new path on the same file system; its name begins with a dot, so listings hide it."""
    return path.with_name(f".{path.name}.{os.urandom(16).hex()}")
