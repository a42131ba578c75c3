"""Writing sample drives, for `bagassets sample`, the demo, tests and benchmarks.

The same seed and profile give the same drive in every format: the messages have the same content
and the same stamps.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from math import inf
from pathlib import Path
from typing import TypeVar

from bagassets.sample.arm import ArmTruth, arm_events
from bagassets.sample.arm_oddities import ARM_ODDITIES
from bagassets.sample.oddities import ODDITIES
from bagassets.sample.recorder import Compression, RecordingFormat, open_recorder
from bagassets.sample.rig import cameras
from bagassets.sample.schedule import Event, drive_events
from bagassets.sample.throughput import throughput_cameras, throughput_events
from bagassets.sample.truth import Truth
from bagassets.sample.world import World

W = TypeVar("W", bound=Truth | ArmTruth)

# The first drive begins on Sunday, 15 June 2025, 15:06:40 UTC; each further seed begins an hour later.
FIRST_START_NS, HOUR_NS = 1_750_000_000_000_000_000, 3_600_000_000_000


@dataclass(frozen=True)
class Profile:
    """A kind of drive.

    Attributes:
        width: of its images in pixels.
        height: of its images in pixels.
        duration_s: default duration.
        throughput: whether it is made to measure speed; see `bagassets.sample.throughput`.
    """

    width: int
    height: int
    duration_s: float
    throughput: bool = False


PROFILES = {
    "small": Profile(320, 200, 4.0),
    "drive": Profile(640, 400, 20.0),
    "tas": Profile(1920, 1080, 10.0, throughput=True),
}


@dataclass(frozen=True)
class Target:
    """A recording to write.

    Attributes:
        path: where.
        format: its format.
        compression: of its messages or chunks.
        parts: number of files of equal length that it is split into, `NAME_0`, `NAME_1`, …; 1 for one of that path.
    """

    path: Path
    format: RecordingFormat
    compression: Compression = "none"
    parts: int = 1


def drive_start_ns(seed: int) -> int:
    """Return the first stamp of the drive of a seed."""
    return FIRST_START_NS + seed * HOUR_NS


def write_recordings(
    targets: Iterable[Target],
    seed: int = 0,
    profile: str = "small",
    duration_s: float | None = None,
    progress: Callable[[float], None] = lambda _seconds: None,
    odd: Sequence[str] = (),
) -> Truth:
    """Write recordings of one drive, which is rendered once, and return its ground truth.

    Args:
        targets: recordings to write.
        seed: each seed has its own world, speed and hour.
        profile: name in `PROFILES`.
        duration_s: duration; default: that of the profile.
        progress: called with the number of seconds written so far.
        odd: names in `oddities.ODDITIES`, applied one after the other; not with throughput.

    Raises:
        RecordingError: something is in the place of a recording already, or its format has no such compression.
    """
    kind = PROFILES[profile]
    make_cameras = throughput_cameras if kind.throughput else cameras
    rig = {camera.channel: camera for camera in make_cameras(kind.width, kind.height)}
    truth = Truth(World(seed), drive_start_ns(seed), rig)
    make_events = partial(throughput_events, seed=seed) if kind.throughput else drive_events
    _write(
        targets, make_events, [ODDITIES[name] for name in odd], truth, duration_s or kind.duration_s, progress
    )
    return truth


def write_arm_recordings(
    targets: Iterable[Target],
    seed: int = 0,
    profile: str = "small",
    duration_s: float | None = None,
    progress: Callable[[float], None] = lambda _seconds: None,
    odd: Sequence[str] = (),
) -> ArmTruth:
    """Write recordings of the sample arm, and return its ground truth; as `write_recordings`, with `ARM_ODDITIES`."""
    kind = PROFILES[profile]
    truth = ArmTruth(seed, drive_start_ns(seed), kind.width, kind.height)
    _write(
        targets,
        arm_events,
        [ARM_ODDITIES[name] for name in odd],
        truth,
        duration_s or kind.duration_s,
        progress,
    )
    return truth


def _write(
    targets: Iterable[Target],
    make_events: Callable[[W, float], Iterator[Event]],
    odd: Iterable[Callable[[Iterator[Event], W], Iterator[Event]]],
    truth: W,
    length_s: float,
    progress: Callable[[float], None],
) -> None:
    """Write the events of a world to all targets."""
    events = make_events(truth, length_s)
    for oddity in odd:
        events = oddity(events, truth)
    with ExitStack() as stack:
        recorders = []
        for one in targets:
            cuts_s = [length_s * part / one.parts for part in range(1, one.parts)]
            for number, (begin_s, end_s) in enumerate(pairwise([-inf, *cuts_s, inf])):
                path = one.path if one.parts == 1 else one.path.with_stem(f"{one.path.stem}_{number}")
                recorders.append((begin_s, end_s, open_recorder(path, one.format, one.compression, stack)))
        for event in events:
            time_s = truth.seconds(event.log_time_ns)
            for begin_s, end_s, recorder in recorders:
                if begin_s <= time_s < end_s:
                    recorder.write(
                        event.topic, event.msgtype, event.log_time_ns, event.make(recorder.messages)
                    )
            progress(time_s)
