"""Waiting for another process that makes the same, instead of making it a second time."""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from bagassets.lock_files import LockFile

__all__ = ["underway"]

_FOLDER = "underway"


@contextmanager
def underway(root: Path, action_digest: str) -> Iterator[None]:
    """Hold the lock of an action in the store in `root`, once no other process holds it.

    The system releases it if the process dies. It saves work and keeps nothing right: where the file
    system has no locks, or the folder cannot be written, two processes make the same artifact.
    """
    path = root / _FOLDER / f"{action_digest}.lock"
    file: LockFile | None = None
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        file = LockFile.open(path, shared=True)
        file.lock()
    try:
        yield
    finally:
        if file is not None:
            with suppress(OSError):
                file.remove()  # who waits for it has it open; who comes now finds the artifact
