"""Opening a recording, whatever its format."""

from collections.abc import Sequence
from pathlib import Path

from bagassets.base.errors import BagAssetsError, RecordingError
from bagassets.recipe.model import Limits
from bagassets.recordings.damage import NOTHING, refuse_pointer, unreadable
from bagassets.recordings.database_file import Database
from bagassets.recordings.mcap_file import McapFile, McapRecording
from bagassets.recordings.model import OnRead, RecordingFiles
from bagassets.recordings.recording import FileRecording, How, Recording
from bagassets.recordings.rosbag1 import IndexReader
from bagassets.recordings.rosbag2 import Rosbag2Recording
from bagassets.recordings.series_recording import SeriesRecording


def open_recording(
    recording: RecordingFiles | Path,
    message_definitions: Sequence[Path] = (),
    limits: Limits | None = None,
    on_read: OnRead | None = None,
) -> Recording:
    """Open a recording.

    Args:
        recording: its files, or its path.
        message_definitions: folders of `.msg` files for types that the recording does not define.
        limits: bounds on sizes; by default those of an empty recipe.
        on_read: called with how far reading has come; it must not raise.

    Raises:
        RecordingError: it is not a readable recording; the message says what to do.
    """
    path = recording.path if isinstance(recording, RecordingFiles) else recording
    how = How(message_definitions, limits or Limits(), on_read)
    if isinstance(recording, RecordingFiles) and recording.parts:
        parts = [part.path for part in recording.parts]
        return SeriesRecording(recording, parts, lambda part: open_recording(part, *how), how)
    if not path.exists():
        raise RecordingError(f"{path}: no such file; it was removed or renamed.")
    if path.is_file() and path.stat().st_size == 0:
        raise RecordingError(f"{path}: the file is empty; {NOTHING}.")
    try:
        if path.is_dir():
            return Rosbag2Recording(path, how)
        refuse_pointer(path)
        if path.suffix == ".mcap":
            return McapRecording(path, "mcap", McapFile(path, how.limits, on_read), how)
        if path.suffix == ".db3":
            return FileRecording(path, "ros2", Database(path, how.limits, on_read), how)
        return FileRecording(path, "ros1", IndexReader(path, how.limits, on_read), how)
    except BagAssetsError:
        raise
    except Exception as err:  # whatever the libraries raise: see `unreadable`
        raise unreadable(path, err) from err
