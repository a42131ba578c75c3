"""Turning unexpected errors into a sentence for users, so that one costs a single asset of a recording, not the run."""

import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bagassets.base.disk_errors import OF_DISKS, disk_advice
from bagassets.base.errors import (
    BagAssetsError,
    MemoryShortageError,
    StoreError,
    UnexpectedError,
    kind_and_text,
)

_OPENCV_NO_MEMORY = -4  # cv2.Error.StsNoMem, as `cv2.error.code`
_PACKAGE = Path(__file__).parents[1]


@contextmanager
def disk_errors_explained(what: str) -> Iterator[None]:
    """Turn errors of a disk into ones that say what cannot be made.

    Raises:
        StoreError: the disk fails, or is full.
    """
    try:
        yield
    except OSError as err:
        if err.errno not in OF_DISKS:
            raise
        raise _disk_failure(err, what) from err


def _disk_failure(err: OSError, what: str) -> StoreError:
    place = "" if err.filename is None else f"{err.filename}: "  # reads of an open file do not name it
    return StoreError(f"{place}{what} cannot be made ({err.strerror}); {disk_advice(err)}.")


def explained_error(err: Exception, path: Path, what: str) -> BagAssetsError:
    """Return a `BagAssetsError` unchanged, and any other error as one that says where it came from.

    Args:
        err: what was raised.
        path: the recording.
        what: name of the node that was being made, such as `frames CAM_FRONT`.
    """
    if isinstance(err, BagAssetsError):
        return err
    if isinstance(err, MemoryError) or getattr(err, "code", None) == _OPENCV_NO_MEMORY:
        return MemoryShortageError(
            f"{path}: {what} ran out of memory; nothing of it is on record. Build again with fewer recordings at a time "
            "(--jobs), or on a machine with more memory."
        )
    if isinstance(err, OSError) and err.errno in OF_DISKS:
        return _disk_failure(err, f"{what} of {path}")
    place = "a library"
    for frame in traceback.extract_tb(err.__traceback__):
        if frame.filename.startswith(str(_PACKAGE)):  # the last one of ours
            place = f"{Path(frame.filename).relative_to(_PACKAGE.parent)}, line {frame.lineno}"
    explained = UnexpectedError(
        f"{path}: {what} met something in this recording that bagassets was not made for ({kind_and_text(err)}; {place}); the others "
        "go on. If the recording is sound, please report this."
    )
    explained.__cause__ = err
    return explained
