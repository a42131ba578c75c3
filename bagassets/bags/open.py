"""Opening a recording, whatever its format."""

import lzma
import sqlite3
import struct
import zlib
from collections.abc import Sequence
from pathlib import Path

from mcap.exceptions import McapError
from rosbags.rosbag1 import ReaderError as Rosbag1Error
from rosbags.rosbag2 import ReaderError as Rosbag2Error

from bagassets.bags.database_file import DatabaseRecording
from bagassets.bags.mcap_file import McapRecording
from bagassets.bags.model import Found
from bagassets.bags.reader import BaseRecording
from bagassets.bags.rosbag import Rosbag1Recording, Rosbag2Recording
from bagassets.errors import RecordingError

__all__ = ["DAMAGE", "open_recording"]

# What the libraries below raise on damaged files, bare assertions included.
DAMAGE = (
    Rosbag1Error,
    Rosbag2Error,
    McapError,
    sqlite3.DatabaseError,
    struct.error,
    AssertionError,
    EOFError,
    KeyError,
    IndexError,
    UnicodeDecodeError,
    ValueError,
    RuntimeError,
    zlib.error,
    lzma.LZMAError,
    OSError,
)
_ADVICE = {
    ".bag": "expected a finished ROS 1 bag; try `rosbag reindex`, or delete the file",
    ".mcap": "expected a finished MCAP; try `mcap recover`, or delete the file",
    ".db3": "expected a ROS 2 SQLite bag; try `sqlite3 FILE .recover`, or delete the file",
    "": "expected a ROS 2 bag folder with metadata.yaml; try `ros2 bag reindex`, or delete it",
}


def open_recording(found: Found | Path, message_definitions: Sequence[Path] = ()) -> BaseRecording:
    """Open a recording.

    Args:
        found: the recording, or its path.
        message_definitions: folders of `.msg` files for types without definition.

    Raises:
        RecordingError: it is not a readable recording; the message says what to do.
    """
    path = found.path if isinstance(found, Found) else found
    advice = _ADVICE.get("" if path.is_dir() else path.suffix, _ADVICE[""])
    if not path.exists():
        raise RecordingError(f"{path}: no such file; it was removed or renamed.")
    if path.is_file() and path.stat().st_size == 0:
        raise RecordingError(f"{path}: the file is empty; {advice}.")
    try:
        if path.is_dir():
            return Rosbag2Recording(path, message_definitions)
        if path.suffix == ".mcap":
            return McapRecording(path, message_definitions)
        if path.suffix == ".db3":
            return DatabaseRecording([path], path, message_definitions)
        return Rosbag1Recording(path, message_definitions)
    except RecordingError:
        raise
    except DAMAGE as err:
        reason = str(err).strip().splitlines()[0] if str(err).strip() else type(err).__name__
        raise RecordingError(f"{path}: it cannot be read ({reason}); {advice}.") from err
