"""Keeping two processes from writing one dataset at the same time."""

import fcntl
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from bagassets.errors import DatasetError

__all__ = ["GUARD", "guarded"]

GUARD = ".bagassets.lock"


@contextmanager
def guarded(output: Path) -> Iterator[None]:
    """Keep other processes from writing into the same folder meanwhile, and name it in errors.

    Raises:
        DatasetError: files cannot be written.
    """
    try:
        output.mkdir(parents=True, exist_ok=True)
        with (output / GUARD).open("w") as guard:
            with suppress(OSError):  # some network file systems have no locks; then builds must not overlap
                fcntl.flock(guard, fcntl.LOCK_EX)
            yield
    except OSError as err:
        raise DatasetError(
            f"{err.filename or output}: the dataset cannot be written ({err.strerror}); free space or mend the folder."
        ) from err
