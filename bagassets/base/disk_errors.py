"""What errors of a disk or file server mean, and what a user can do about each."""

from errno import EDQUOT, EIO, ENODEV, ENOSPC, ENXIO, EROFS, ESTALE, ETIMEDOUT

FULL = frozenset({EDQUOT, ENOSPC})
# The disk or file server does not answer, whatever is read or written.
_FAILING = frozenset({EIO, ENODEV, ENXIO, ESTALE, ETIMEDOUT})
_ADVICE = {
    **dict.fromkeys(FULL, "free disk space"),
    **dict.fromkeys(_FAILING, "check the disk or file server, and try again"),
    EROFS: "mount its disk for writing, or use another folder",
}
OF_DISKS = _ADVICE.keys()
_USUAL = "free disk space, or make the folder writable"


def disk_advice(err: Exception, usual: str = _USUAL) -> str:
    """Return what to do about an error of reading or writing, as a clause.

    Args:
        err: the error.
        usual: what to do unless the disk itself refuses; by default what helps against most failed writes.
    """
    return _ADVICE.get(err.errno or 0, usual) if isinstance(err, OSError) else usual


def disk_fails(err: BaseException) -> bool:
    """Tell whether a disk or file server does not answer."""
    return isinstance(err, OSError) and err.errno in _FAILING
