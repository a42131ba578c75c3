"""All changes to files of the store, of datasets, and of what a project notes of them; and files that appear whole.

What others may see is complete or not there at all: it is written beside its final path, and moved there when complete.
Nothing is synced to disk: whoever reads a file must notice if a power loss tore it.

Every change goes through the `os`, `shutil`, `open` and `ioctl` of this module, which tests replace: by ones that record the
changes, to replay some of them as a crash would leave them, or that fail at one (docs/reliability.md).
"""

import ctypes
import errno
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from fcntl import ioctl
from pathlib import Path
from typing import BinaryIO

_NO_HARD_LINK = {errno.EPERM, errno.EOPNOTSUPP, errno.ENOSYS, errno.EACCES, errno.EMLINK}
FICLONE = 0x40049409  # linux/fs.h: make a file share the blocks of another
# Linux: arguments of renameat2, and its errors on file systems that cannot do what the flag says.
_AT_FDCWD = -100
_RENAME_NOREPLACE, _RENAME_EXCHANGE = 1, 2
_NO_FLAG = {errno.EINVAL, errno.ENOSYS, errno.EOPNOTSUPP}

AnyPath = str | os.PathLike[str]

# --- single changes; each raises OSError if it is not possible --------------------------------


def make_folder(path: AnyPath, *, new: bool = False) -> None:
    """Create a folder and those above it, unless it exists; with `new`, it must not."""
    if new or not os.path.isdir(path):
        os.makedirs(path, exist_ok=not new)


def write(path: AnyPath, content: bytes | memoryview, *, new: bool = False, mode: int = 0o666) -> None:
    """Write a file where nobody looks yet: whoever did would see half of it. With `new`, it must not exist."""
    flags = os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC | (os.O_EXCL if new else os.O_TRUNC)
    descriptor = os.open(path, flags, mode)
    try:
        rest = memoryview(content).cast("B")
        while rest:
            rest = rest[os.write(descriptor, rest) :]
    except OSError as err:
        raise OSError(err.errno, err.strerror, os.fspath(path)) from err  # which `write` does not name
    finally:
        os.close(descriptor)


def writer(path: AnyPath) -> BinaryIO:
    """Open a file to be written bit by bit, where nobody looks yet."""
    return open(path, "wb", buffering=1 << 20)


def copy(source: AnyPath, target: AnyPath) -> None:
    """Copy the bytes of a file to where nobody looks yet."""
    shutil.copyfile(source, target)


def clone(source: AnyPath, target: AnyPath) -> bool:
    """Make a reflink where nobody looks yet; return False, with an empty file there, if the file system cannot."""
    with Path(source).open("rb") as original, writer(target) as copied:
        try:
            ioctl(copied.fileno(), FICLONE, original.fileno())
        except OSError:
            return False
    return True


def link(source: AnyPath, target: AnyPath) -> None:
    """Give a file another name, which must not exist."""
    os.link(source, target)


def move(source: AnyPath, target: AnyPath) -> None:
    """Give a file or folder another name; a file, or an empty folder, of that name is replaced."""
    os.rename(source, target)


def mark(path: AnyPath) -> None:
    """Set the modification time of a file or folder to now."""
    os.utime(path)


def remove(path: AnyPath) -> bool:
    """Remove a file; return False if it is not there."""
    try:
        os.unlink(path)
    except FileNotFoundError:
        return False
    return True


def remove_empty(folder: AnyPath) -> None:
    """Remove a folder if it is there and empty."""
    with suppress(OSError):
        os.rmdir(folder)


def remove_all(folder: AnyPath) -> None:
    """Remove a folder with all that is in it, as far as possible: what stays is removed another time."""
    shutil.rmtree(folder, ignore_errors=True)


def sync_folder(folder: AnyPath) -> None:
    """Wait until the names in a folder are on the disk, as far as the file system can tell."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def open_lock(path: AnyPath, flags: int, mode: int) -> int:
    """Open a lock file, which may be created, and return its descriptor."""
    return os.open(path, flags, mode)


# --- what appears whole -----------------------------------------------------------------------


@contextmanager
def replacing(path: Path, within: Path | None = None) -> Iterator[Path]:
    """Write a file beside `path` in the block, or in another folder; it replaces `path` if the block succeeds.

    Yields:
        The path to write to, hidden and on the same file system. Nothing is left there in the end, unless the process is
        killed.

    Raises:
        OSError: the file cannot be moved into place.
    """
    temporary = _beside(path if within is None else within / path.name)
    try:
        yield temporary
        move(temporary, path)
    except BaseException:
        with suppress(OSError):
            remove(temporary)
        raise


def write_atomically(
    path: Path, content: bytes, *, mode: int = 0o666, folders: bool = False, within: Path | None = None
) -> None:
    """Create or replace a file at once, in an existing folder, or, with `folders`, in one that is made if need be.

    It is written beside its path, or `within` another folder on the same file system.

    Raises:
        OSError: it cannot be written.
    """
    if folders:
        make_folder(path.parent)
    with replacing(path, within) as temporary:
        write(temporary, content, mode=mode)


def create_atomically(path: Path, content: bytes) -> bool:
    """Create a file, and the folders above it, unless it exists: the first writer wins, and nobody sees half of it.

    Where the file system has neither hard links nor a rename that replaces nothing, two writers that come at the same
    moment may both count as the first; the file is that of the last.

    Returns:
        True if the file was created, False if it existed before.

    Raises:
        OSError: it cannot be written.
    """
    temporary = _beside(path)
    make_folder(path.parent)
    try:
        write(temporary, content)
        try:
            link(temporary, path)
        except OSError as err:
            if err.errno not in _NO_HARD_LINK:
                raise
            if not _rename(temporary, path, _RENAME_NOREPLACE):
                if path.exists():
                    return False
                move(temporary, path)
    except FileExistsError:
        return False
    finally:
        with suppress(OSError):
            remove(temporary)
    return True


def swap_in(new: Path, current: Path) -> Path | None:
    """Put the folder `new` in place of `current`, so that readers see either the old folder or the new one.

    Linux exchanges the two atomically. Elsewhere `current` is renamed away first, and for an instant there is none.

    Returns:
        The path of the old folder, or None if there was none.
    """
    if not current.exists():
        move(new, current)
        return None
    if _rename(new, current, _RENAME_EXCHANGE):
        return new
    old = current.with_name(f"{new.name}-old-{os.urandom(16).hex()}")
    move(current, old)
    move(new, current)
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
