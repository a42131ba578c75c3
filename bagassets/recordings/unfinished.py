"""What recorders leave that were stopped: bags without an index, files that were being compressed, logs without a database.

Recordings that somebody has compressed are listed with them: they are no recordings either, and should not go unnoticed.
"""

import os
import time
from pathlib import Path

from bagassets.recordings.join_parts import FOR_NOW

COMPRESSORS = frozenset({".zstd", ".zst", ".gz", ".xz", ".bz2", ".lz4"})
"""Suffixes that programs give to what they compress; `.zstd` is that of recorders, too."""
SUFFIXES = frozenset({".active", ".db3-wal", ".db3-journal", *COMPRESSORS})
"""Of files that may be left."""

_BAG = ".bag.active"
# A recorder writes its buffers now and then; of one that records slowly that may take minutes.
_QUIET_S = 600.0
_HEADER_BYTES = 32  # of a log that holds nothing
_AT_WORK = f"{FOR_NOW} (it has grown within the last ten minutes, so its recorder may be at work); later it is taken as a recording"
_COMPRESSED = (
    "compressed by a recorder that wrote no metadata.yaml, so it may be half-written; `bagassets doctor` says what is in it, and "
    "`--write` makes a bag of that"
)


def whole_name(name: str) -> str | None:
    """Return the name that a bag gets when it is finished, whose key it has; None if the file is none that is not."""
    return name.removesuffix(".active") if name.endswith(_BAG) else None


def reason(path: Path, status: os.stat_result) -> str:
    """Return what a file with one of `SUFFIXES` is, and why it is no recording; "" if it is one, or of no interest.

    Args:
        path: the file.
        status: of it.
    """
    name, beside = path.name, path.with_suffix("")
    if name.endswith(_BAG):
        if beside.exists():
            return f"unfinished, and {beside.name} lies beside it, which is taken"
        return _AT_WORK if 0 <= time.time() - status.st_mtime < _QUIET_S else ""
    if name.endswith((".db3.zstd", ".mcap.zstd")):
        at_work = f"{beside.name} was being compressed into it, which is the recording"
        return at_work if beside.exists() else _COMPRESSED
    if path.suffix in COMPRESSORS and beside.suffix in {".bag", ".mcap", ".db3"}:
        is_there = f"{beside.name} lies beside it, which is taken"
        return f"compressed as a whole; {is_there if beside.exists() else f'decompress it to {beside.name}'}"
    if path.suffix not in {".db3-wal", ".db3-journal"} or status.st_size <= _HEADER_BYTES:
        return ""
    database = path.with_name(name.rpartition("-")[0])
    return (
        ""
        if database.exists()
        else f"the last messages of {database.name}, which is not here; copy that beside it"
    )
