"""Files that others see whole or not at all: written beside their place, and moved there when they are complete.

Nothing waits for the disk: what a power loss tears is for whoever reads it to notice.
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
    """Have the block write a file beside `path`, which then takes the place of `path` if the block ends well.

    Yields:
        The name to write to, hidden and on the same file system. Nothing is left under it in the end.

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
    """Write a file, or replace it in one step, in a folder that exists.

    Raises:
        OSError: it cannot be written.
    """
    with replacing(path) as temporary:
        temporary.write_bytes(content)


def create_atomically(path: Path, content: bytes) -> bool:
    """Write a file, in a folder that exists, unless there is one of this name: the first writer wins.

    Where the file system has no hard links it is not done in one step, and a file may be torn.

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
    """Return a new name on the same file system; its dot hides it from whoever lists files."""
    return path.with_name(f".{path.name}.{os.urandom(16).hex()}")
