"""What errors of a disk or file server mean, and what a user can do about each."""

from errno import EDQUOT, EIO, ENODEV, ENOSPC, ENXIO, EROFS, ESTALE, ETIMEDOUT

FULL = frozenset({EDQUOT, ENOSPC})
# The disk or file server does not answer, whatever is read or written.
FAILING = frozenset({EIO, ENODEV, ENXIO, ESTALE, ETIMEDOUT})
READ_ONLY = EROFS
_USUAL = "free disk space, or make the folder writable"


def disk_advice(err: Exception, usual: str = _USUAL) -> str:
    """Return what to do about an error of reading or writing, as a clause.

    Args:
        err: the error.
        usual: what to do unless the disk itself refuses; by default what helps against most failed writes.
    """
    number = err.errno if isinstance(err, OSError) else None
    if number in FAILING:
        return "check the disk or file server, and try again"
    if number in FULL:
        return "free disk space"
    return "mount its disk for writing, or use another folder" if number == READ_ONLY else usual
