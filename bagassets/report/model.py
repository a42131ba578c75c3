"""Data of a report, independent of where it is from."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from bagassets.engine.splits import SplitShare


@dataclass(frozen=True)
class Gaps:
    """The pauses of one topic: how many, and the longest."""

    topic: str
    number: int
    longest_s: float


@dataclass(frozen=True)
class Problem:
    """What a check found: the name of the check, `warn` or `error`, the first sentence, and how many there are more."""

    check: str
    weight: str
    sentence: str
    more: int = 0


@dataclass(frozen=True)
class RecordingFacts:
    """One recording.

    Attributes:
        key: partition key.
        state: `ready`, `skipped`, `failed`, `copy` (of another recording, which is in the dataset for both), or `stale`
            (facts may be those of an older version).
        reason: why it is skipped, failed, a copy or stale.
        format: ros1, ros2 or mcap.
        size: bytes of its files; None if it has no inventory.
        start_ns: log time of its first message.
        duration_s: its length.
        scenes_s: length of its scenes; a pause, or a clock that was set, lies between scenes.
        rig: name of the rig.
        split: name of its split.
        daylight: day, night, twilight, or None if unknown.
        length_m: metres driven.
        counts: what its assets count, such as images, boxes and scenes -> number.
        boxes: category -> number of boxes.
        lost: a line per channel or topic and reason about what was lost.
        problems: what checks found.
        checks_passed: how many checks found nothing.
        gaps: topics with pauses, the worst first.
        points: latitude and longitude of its route, in order of time; empty if the place on Earth is unknown.
        local: x and y of it, in metres in the recording's global frame.
        pictures: name -> small picture as JPEG file, in the order of the report.
        thumbnail: a very small picture.
        full_pictures: folder of the pictures in full size.
        notes: sentences about what is unusual.
    """

    key: str
    state: str
    reason: str = ""
    format: str = ""
    size: int | None = None
    start_ns: int | None = None
    duration_s: float = 0.0
    scenes_s: float = 0.0
    rig: str = ""
    split: str = ""
    daylight: str | None = None
    length_m: float | None = None
    counts: Mapping[str, int] = field(default_factory=dict)
    boxes: Mapping[str, int] = field(default_factory=dict)
    lost: Sequence[str] = ()
    problems: Sequence[Problem] = ()
    checks_passed: int = 0
    gaps: Sequence[Gaps] = ()
    points: Sequence[tuple[float, float]] = ()
    local: Sequence[tuple[float, float]] = ()
    pictures: Mapping[str, Path] = field(default_factory=dict)
    thumbnail: Path | None = None
    full_pictures: Path | None = None
    notes: Sequence[str] = ()


@dataclass(frozen=True)
class ReportData:
    """The whole dataset.

    Attributes:
        name: name of the project.
        dataset: folder of the nuScenes dataset.
        recordings: sorted by key.
        excluded: path below the bag root -> reason why it is excluded.
        shares: each split's share.
        idle_pins: keys pinned to a split in the recipe that no recording has.
        problems: what checks of whole datasets found.
        checks_passed: how many of those found nothing.
        counted: the names of what recordings count, in order.
    """

    name: str
    dataset: Path
    recordings: Sequence[RecordingFacts]
    excluded: Mapping[str, str] = field(default_factory=dict)
    shares: Sequence[SplitShare] = ()
    idle_pins: Sequence[str] = ()
    problems: Sequence[Problem] = ()
    checks_passed: int = 0
    counted: Sequence[str] = ()
