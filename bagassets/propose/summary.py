"""What the first messages of a recording say of its topics and frames, and that of several recordings together."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Literal, get_args

from bagassets.decode.point_times import PointClock
from bagassets.decode.registry import types_of
from bagassets.decode.video_units import Codec
from bagassets.geometry.se3 import SE3

Edge = tuple[str, str]
"""Parent and child frame, without leading slash."""

Vector = tuple[float, float, float]
MOST_KEPT = 20
"""Names and texts of a topic."""


@dataclass(frozen=True)
class TopicSummary:
    """One topic.

    Attributes:
        name: topic as recorded.
        msgtype: normalised type, `pkg/msg/Type`.
        count: number of messages in the recording.
        problem: why messages cannot be decoded; None if they can.
        frames: frames in the headers seen, without leading slash; an empty frame is left out.
        child_frames: `child_frame_id` of odometry messages seen.
        offset_s: median of log time minus header stamp; None without header or with unset stamps.
        unstamped: the stamps in the headers of messages are zero, or packets have no header.
        encoding: encoding of images, `jpeg` or `png` of compressed ones, as of `ImageReading`; codec of video.
        is_16_bit: images have more than 8 bit a channel; None for other types.
        calibrated: a CameraInfo with usable numbers was seen; None for other types.
        oriented: an Imu gives orientation; None for other types.
        acceleration: sum of the accelerations that an Imu measured, m/s², in its frame; None if it measures none.
        ncom_sender: IPv4 address that OxTS NCOM packets come from; "" if there are some but the
            messages do not tell; None if there are none.
        packets_of: whose data packets were seen, Velodyne or Hesai; "" if none of a known lidar, None if the type holds no packets.
        timed: the points of a cloud, the rays of a scan or the packets of a lidar have times; None for other types.
        clock: what the times of the points of a PointCloud2 are; None without.
        is_of_radar: such clouds have a field that radars fill.
        most_intensity: the largest intensity in such clouds; None if all are 0 or 1.
        refusal: why none of the messages seen is what its type is there for; None if one is, or nothing
            is made of the type.
        velocities: what the velocities of a radar are, or `undecided`: what each recording says; empty if there is
            nothing to decide.
        urdf: the robot description that it carries, as XML; "" if none.
        elements: what the numbers of messages are called that may be a signal: each set of names that was seen.
        texts: short texts that it carries.
        rate_hz: mean rate by log time in what was read; None if that is too little.
    """

    name: str
    msgtype: str
    count: int
    problem: str | None = None
    frames: tuple[str, ...] = ()
    child_frames: tuple[str, ...] = ()
    offset_s: float | None = None
    unstamped: bool = False
    encoding: str | None = None
    is_16_bit: bool | None = None
    calibrated: bool | None = None
    oriented: bool | None = None
    acceleration: Vector | None = None
    ncom_sender: str | None = None
    packets_of: str | None = None
    timed: bool | None = None
    clock: PointClock | None = None
    is_of_radar: bool = False
    most_intensity: float | None = None
    refusal: str | None = None
    velocities: frozenset[str] = frozenset()
    urdf: str = ""
    elements: tuple[tuple[str, ...], ...] = ()
    texts: tuple[str, ...] = ()
    rate_hz: float | None = None

    @property
    def is_video(self) -> bool:
        """True if it carries video, which messages for images may hold."""
        return self.encoding in get_args(Codec)


Status = Literal["used", "not decodable", "left out", "not needed"]
USES: tuple[Status, ...] = get_args(Status)
"""What becomes of topics, in the order in which they are listed."""


@dataclass(frozen=True)
class TopicUse:
    """What becomes of a topic.

    Attributes:
        topic: the topic.
        status: whether it is used, and if not, in which way.
        text: as what it is used, or why it is not; "" for topics that are not needed.
    """

    topic: TopicSummary
    status: Status
    text: str = ""


@dataclass(frozen=True)
class RecordingSummary:
    """One recording, or several merged ones.

    Attributes:
        topics: name -> topic.
        transforms: edge of the TF tree -> `parent_SE3_child` as first seen.
        moving: edges whose transform changed in the messages seen.
        static: edges on topics with static transforms.
        short_s: topic -> time between its first and its last message, of the sensors' topics that are too short for a
            scene by default.
        robots: namespace of each robot, if several were recorded -> whether it has sensors; all else is about the first.
    """

    topics: Mapping[str, TopicSummary]
    transforms: Mapping[Edge, SE3] = field(default_factory=dict)
    moving: frozenset[Edge] = frozenset()
    short_s: Mapping[str, float] = field(default_factory=dict)
    robots: Mapping[str, bool] = field(default_factory=dict)
    static: frozenset[Edge] = frozenset()

    @property
    def edges(self) -> frozenset[Edge]:
        """Edges of the TF tree."""
        return frozenset(self.transforms)


def transform_topics(summary: RecordingSummary, *, decodable: bool = True) -> list[str]:
    """Return the topics with transforms that can be decoded, or that cannot."""
    types = set(types_of("transforms"))
    topics = [topic for topic in summary.topics.values() if topic.msgtype in types and topic.count > 0]
    return [topic.name for topic in topics if (topic.problem is None) is decodable]


def merge_recordings(summaries: Iterable[RecordingSummary]) -> RecordingSummary:
    """Return several recordings as one: counts add up, and it is as long as the longest."""
    topics: dict[str, TopicSummary] = {}
    transforms: dict[Edge, SE3] = {}
    moving: frozenset[Edge] = frozenset()
    static: frozenset[Edge] = frozenset()
    short_s: dict[str, float] = {}
    long: set[str] = set()
    robots: dict[str, bool] = {}
    for one in summaries:
        robots |= {name: has_sensors or robots.get(name, False) for name, has_sensors in one.robots.items()}
        transforms = {**one.transforms, **transforms}
        moving |= one.moving
        static |= one.static
        for name, topic in one.topics.items():
            if name in one.short_s:
                short_s[name] = max(one.short_s[name], short_s.get(name, 0.0))
            elif topic.count:
                long.add(name)
            topics[name] = merge_topics(topics[name], topic) if name in topics else topic
    short_s = {name: length_s for name, length_s in short_s.items() if name not in long}
    return RecordingSummary(dict(sorted(topics.items())), transforms, moving, short_s, robots, static)


def merge_topics(one: TopicSummary, other: TopicSummary) -> TopicSummary:
    """Return a topic from messages of two recordings, or from two messages."""
    offsets = [value for value in (one.offset_s, other.offset_s) if value is not None]
    return TopicSummary(
        name=one.name,
        msgtype=one.msgtype,
        count=one.count + other.count,
        problem=one.problem and other.problem,
        frames=tuple(dict.fromkeys((*one.frames, *other.frames))),
        child_frames=tuple(dict.fromkeys((*one.child_frames, *other.child_frames))),
        offset_s=max(offsets, key=abs) if offsets else None,
        unstamped=one.unstamped or other.unstamped,
        encoding=one.encoding or other.encoding,
        is_16_bit=_any(one.is_16_bit, other.is_16_bit),
        calibrated=_any(one.calibrated, other.calibrated),
        oriented=_any(one.oriented, other.oriented),
        acceleration=_sum(one.acceleration, other.acceleration),
        ncom_sender=one.ncom_sender or (one.ncom_sender if other.ncom_sender is None else other.ncom_sender),
        packets_of=one.packets_of or (one.packets_of if other.packets_of is None else other.packets_of),
        timed=_any(one.timed, other.timed),
        clock=one.clock if one.clock and (one.clock.doubt or not other.clock) else other.clock,
        is_of_radar=one.is_of_radar or other.is_of_radar,
        most_intensity=max((one.most_intensity, other.most_intensity), key=lambda most: most or 0.0),
        refusal=one.refusal and other.refusal,
        velocities=one.velocities | other.velocities,
        urdf=one.urdf or other.urdf,
        elements=tuple(dict.fromkeys((*one.elements, *other.elements)))[:MOST_KEPT],
        texts=tuple(dict.fromkeys((*one.texts, *other.texts)))[:MOST_KEPT],
        rate_hz=other.rate_hz if one.rate_hz is None else one.rate_hz,
    )


def _any(one: bool | None, other: bool | None) -> bool | None:
    return other if one is None else one or bool(other)


def _sum(one: Vector | None, other: Vector | None) -> Vector | None:
    if one is None or other is None:
        return other if one is None else one
    return one[0] + other[0], one[1] + other[1], one[2] + other[2]
