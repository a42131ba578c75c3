"""Protecting a dataset from two writers at once, and from files that differ from those expected."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from bagassets.base.disk_errors import disk_advice
from bagassets.base.errors import DatasetError
from bagassets.base.files import remove_all
from bagassets.base.lock_files import LockFile

GUARD = ".bagassets.lock"


@contextmanager
def guarded(output: Path) -> Iterator[None]:
    """Keep other processes from writing into a dataset, and name it in errors.

    Raises:
        DatasetError: files cannot be written.
    """
    try:
        with LockFile.open(output / GUARD, shared=True) as guard:
            with suppress(OSError):  # some network file systems have no locks; then builds must not overlap
                guard.lock()
            yield
    except OSError as err:
        raise DatasetError(
            f"{err.filename or output}: the dataset cannot be written ({err.strerror}); {disk_advice(err)}."
        ) from err


def refuse_unexpected(folder: Path, made: Mapping[str, str], expected: Mapping[str, str] | None) -> None:
    """Remove a new folder and raise if its files are not those expected.

    Args:
        folder: the folder.
        made: digests of its files, by name.
        expected: digests that they must have; None allows any.

    Raises:
        DatasetError: a file differs.
    """
    if expected is None or dict(expected) == dict(made):
        return
    names = sorted(name for name in {*made, *expected} if made.get(name) != expected.get(name))
    remove_all(folder)
    raise DatasetError(
        f"{folder.parent}: {', '.join(names)} would differ from the lock, so the dataset stays as it was; use the "
        "version of bagassets that wrote the lock."
    )
