"""How users are told that a recording is damaged."""

from pathlib import Path

from bagassets.errors import RecordingError

__all__ = ["advice_for", "damaged"]

_ADVICE = {
    ".bag": "expected a finished ROS 1 bag; try `rosbag reindex`, or delete the file",
    ".mcap": "expected a finished MCAP; try `mcap recover`, or delete the file",
    ".db3": "expected a ROS 2 SQLite bag; try `sqlite3 FILE .recover`, or delete the file",
    "": "expected a ROS 2 bag folder with metadata.yaml; try `ros2 bag reindex`, or delete it",
}


def advice_for(path: Path) -> str:
    """Return what was expected of a recording and what to do about it."""
    return _ADVICE.get("" if path.is_dir() else path.suffix, _ADVICE[""])


def damaged(path: Path, err: BaseException) -> RecordingError:
    """Return the error for whatever a library raised when it read a recording.

    On damaged bytes these libraries raise anything: errors of their own, of databases and
    decompressors, bare assertions, lookups that fail.
    """
    text = str(err).strip()
    reason = text.splitlines()[0] if text else type(err).__name__
    return RecordingError(f"{path}: it cannot be read ({reason}); {advice_for(path)}.")
