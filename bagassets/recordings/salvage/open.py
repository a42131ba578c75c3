"""Opening a recording that the ordinary readers refuse, whatever its format, and reading it where it is damaged or not."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TypeVar

from bagassets.base.errors import BagAssetsError, RecordingError
from bagassets.recipe.model import Limits
from bagassets.recordings.damage import hole_reason, refuse_pointer, suffix_of, unreadable
from bagassets.recordings.journals import scratch_folder
from bagassets.recordings.model import OnRead, RecordingFiles
from bagassets.recordings.open import open_recording
from bagassets.recordings.recording import FileRecording, How, Recording
from bagassets.recordings.salvage.damage_map import Damage, Hole
from bagassets.recordings.salvage.database_pages import SalvagedDatabase
from bagassets.recordings.salvage.folder import SalvagedFolder
from bagassets.recordings.salvage.mcap_scan import SalvagedMcap
from bagassets.recordings.salvage.rosbag1_scan import SalvagedBag
from bagassets.recordings.salvage.unpack import unpack_file
from bagassets.recordings.series_recording import SeriesRecording
from bagassets.recordings.sizes import Sizes

T = TypeVar("T")


def open_salvaged(
    recording: RecordingFiles | Path,
    message_definitions: Sequence[Path] = (),
    limits: Limits | None = None,
    on_read: OnRead | None = None,
    damage: Damage | None = None,
) -> Recording:
    """Open a recording, damaged or not, for what can be read of it.

    Args:
        recording: its files, or its path.
        message_definitions: folders of `.msg` files for types that the recording does not define.
        limits: bounds on sizes; by default those of an empty recipe.
        on_read: called with how far reading has come; it must not raise.
        damage: takes what is found damaged; by default one of its own, which is `Recording.damage`.

    Raises:
        RecordingError: nothing of a recording is there.
    """
    path = recording.path if isinstance(recording, RecordingFiles) else recording
    how, damage = How(message_definitions, limits or Limits(), on_read), damage or Damage()
    try:
        if isinstance(recording, RecordingFiles) and recording.parts:
            opened = _series(recording, how, damage)
        else:
            opened = _one(path, how, damage)
    except BagAssetsError:
        raise
    except Exception as err:  # whatever the libraries raise: see `unreadable`
        raise unreadable(path, err) from err
    opened.damage = damage
    return opened


def _one(path: Path, how: How, damage: Damage) -> Recording:
    if path.is_dir():
        return SalvagedFolder(path, how, damage)
    refuse_pointer(path)
    if path.suffix == ".zstd":
        sizes = Sizes(path, path.stat().st_size, how.limits)
        with scratch_folder(path, path.stat().st_size) as folder:
            plain = folder / path.stem
            if problem := unpack_file(path, plain, sizes, how.on_read):
                damage.hole(Hole(path.name, path.stat().st_size, path.stat().st_size, problem))
            return _one(plain, how, damage)
    if suffix_of(path) == ".mcap":
        return FileRecording(path, "mcap", SalvagedMcap(path, how.limits, how.on_read, damage), how)
    if suffix_of(path) == ".db3":
        database = SalvagedDatabase(path, how.limits, how.on_read, damage)
        database.note_unnamed()
        return FileRecording(path, "ros2", database, how)
    return FileRecording(path, "ros1", SalvagedBag(path, how.limits, how.on_read, damage), how)


def _series(recording: RecordingFiles, how: How, damage: Damage) -> Recording:
    """Open the parts that can be; each of the others is a hole."""
    once: dict[Path, Recording] = {}

    def opened(path: Path) -> Recording:
        return once.pop(path, None) or open_salvaged(path, *how, damage)

    parts = []
    for part in recording.parts:
        before = dict(damage.holes), dict(damage.findings)
        try:
            once[part.path] = open_salvaged(part.path, *how, damage)
        except RecordingError as err:
            if err.transient:
                raise
            damage.holes, damage.findings = before
            reason = hole_reason(part.path, err)
            damage.hole(Hole(part.path.name, 0, part.size, reason), is_counted=False)
        else:
            parts.append(part.path)
    if not parts:
        raise RecordingError(
            f"{recording.path}: none of its parts can be read; copy them again from where they were recorded."
        )
    return SeriesRecording(recording, parts, opened, how)


def read_as_far(
    recording: RecordingFiles,
    read: Callable[[Recording], T],
    message_definitions: Sequence[Path] = (),
    limits: Limits | None = None,
) -> T:
    """Return what `read` gives of a recording or, if that is damaged, of what can be read of it.

    Raises:
        RecordingError: nothing can be read.
    """
    try:
        with open_recording(recording, message_definitions, limits) as opened:
            return read(opened)
    except RecordingError as err:
        if err.transient:
            raise
        with suppress(RecordingError), open_salvaged(recording, message_definitions, limits) as opened:
            if any(topic.count for topic in opened.topics.values()):
                return read(opened)
        raise
