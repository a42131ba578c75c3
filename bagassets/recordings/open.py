"""Opening a recording, whatever its format."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from bagassets.base.errors import BagAssetsError, RecordingError
from bagassets.recipe.model import Limits
from bagassets.recordings.damage import advice_for, refuse_pointer, unreadable
from bagassets.recordings.database_file import Database
from bagassets.recordings.mcap_file import McapFile, McapRecording
from bagassets.recordings.model import OnRead, RecordingFiles
from bagassets.recordings.recording import FileRecording, Recording
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
    limits = limits or Limits()
    if isinstance(recording, RecordingFiles) and recording.parts:
        opener = partial(
            open_recording, message_definitions=message_definitions, limits=limits, on_read=on_read
        )
        parts = [part.path for part in recording.parts]
        return SeriesRecording(path, recording.format, parts, opener, message_definitions, limits)
    if not path.exists():
        raise RecordingError(f"{path}: no such file; it was removed or renamed.")
    if path.is_file() and path.stat().st_size == 0:
        raise RecordingError(f"{path}: the file is empty; {advice_for(path)}.")
    try:
        if path.is_dir():
            return Rosbag2Recording(path, message_definitions, limits, on_read)
        refuse_pointer(path)
        if path.suffix == ".mcap":
            mcap = McapFile(path, limits, on_read)
            return McapRecording(path, "mcap", mcap, message_definitions, limits)
        if path.suffix == ".db3":
            database = Database(path, limits, on_read)
            return FileRecording(path, "ros2", database, message_definitions, limits)
        return FileRecording(path, "ros1", IndexReader(path, limits, on_read), message_definitions, limits)
    except BagAssetsError:
        raise
    except Exception as err:  # whatever the libraries raise: see `unreadable`
        raise unreadable(path, err) from err
