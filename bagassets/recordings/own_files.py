"""Files that look like recordings, and are what we made of some: scenes that `bagassets view` wrote."""

import os
import re
import struct
from functools import lru_cache
from pathlib import Path

VIEW_LIBRARY = "bagassets view"
"""What an MCAP file of ours names as its writer, before the version."""

_MAGIC = b"\x89MCAP0\r\n"
_HEADER = 0x01
# Before scenes had a name of their own, they named the package and its version.
_WRITER = re.compile(rf"(?:{VIEW_LIBRARY}|bagassets) \d")
_HEAD_BYTES = 256


def is_view_file(path: Path, status: os.stat_result) -> bool:
    """Tell whether an MCAP file was written by `bagassets view`; its head is read once as long as it stays as it is.

    Args:
        path: the file.
        status: of the file.
    """
    return _is_view_file(str(path), status.st_ino, status.st_size, status.st_mtime_ns)


# Folders are walked every few seconds, and each open takes a round trip where the files are on a server.
@lru_cache(maxsize=100_000)
def _is_view_file(path: str, _inode: int, _size: int, _mtime_ns: int) -> bool:
    try:
        with open(path, "rb") as file:  # noqa: PTH123  (a Path per file is slow)
            head = file.read(_HEAD_BYTES)
    except OSError:
        return False  # whoever opens it will say why
    try:
        magic, record = struct.unpack_from("<8sB", head)
        (profile,) = struct.unpack_from("<I", head, 17)
        (length,) = struct.unpack_from("<I", head, 21 + profile)
    except struct.error:
        return False
    library = head[25 + profile : 25 + profile + length].decode("utf-8", "replace")
    return magic == _MAGIC and record == _HEADER and _WRITER.match(library) is not None
