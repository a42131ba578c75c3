"""A glance at a recording: its topics, and what the first few messages of each say.

Proposing a recipe needs frames, encodings and the TF tree, but not every message. Reading the
first seconds keeps `bagassets init` quick on terabytes; the inventory reads everything later.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from statistics import median
from typing import Any

from bagassets.bags.model import RawMessage, Recording
from bagassets.errors import DecodeError

__all__ = ["Glance", "TopicGlance", "glance", "merge_glances"]

Edge = tuple[str, str]
"""Parent and child frame, without leading slash."""

_SECONDS = 5.0
_MESSAGES = 20
_BULK_MESSAGES = 3
_BULK_TYPES = frozenset(
    {
        "sensor_msgs/msg/Image",
        "sensor_msgs/msg/CompressedImage",
        "sensor_msgs/msg/PointCloud2",
        "velodyne_msgs/msg/VelodyneScan",
    }
)
_LATE_MESSAGES = 3
_PACKET_KINDS = frozenset({"Packet", "UdpPacket", "UInt8MultiArray"})
_STILL_M_RAD = 1e-4


@dataclass(frozen=True)
class TopicGlance:
    """What is known of one topic.

    Attributes:
        name: topic as recorded.
        msgtype: normalised type, `pkg/msg/Type`.
        count: number of messages in the recording.
        problem: why messages cannot be decoded; None if they can.
        frames: frames in the headers seen, without leading slash; an empty frame is left out.
        child_frames: `child_frame_id` of odometry messages seen.
        offset_s: median of log time minus header stamp; None without header or with unset stamps.
        unstamped: messages have a header, but its stamp is zero.
        encoding: encoding of images, or `format` of compressed images.
        calibrated: a CameraInfo with a focal length was seen; None for other types.
        oriented: an Imu gives orientation; None for other types.
        ncom_sender: IPv4 address that OxTS NCOM packets come from; "" if there are some but the
            messages do not tell; None if there are none.
        message_bytes: size of the first message; 0 if none was seen.
        timed: the points of a cloud or the rays of a scan have times; None for other types.
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
    calibrated: bool | None = None
    oriented: bool | None = None
    ncom_sender: str | None = None
    message_bytes: int = 0
    timed: bool | None = None


@dataclass(frozen=True)
class Glance:
    """What is known of one recording, or of several merged ones.

    Attributes:
        topics: name -> what is known.
        edges: edges of the TF tree that were seen.
        moving: those of them whose transform changed while looking.
    """

    topics: Mapping[str, TopicGlance]
    edges: frozenset[Edge] = frozenset()
    moving: frozenset[Edge] = frozenset()


@dataclass
class _Seen:
    """What accumulates about a topic while messages pass."""

    count: int = 0
    bytes: int = 0
    offsets_s: list[float] = field(default_factory=list)
    zero_stamps: int = 0
    frames: dict[str, None] = field(default_factory=dict)
    child_frames: dict[str, None] = field(default_factory=dict)
    encoding: str | None = None
    calibrated: bool | None = None
    oriented: bool | None = None
    ncom_sender: str | None = None
    timed: bool | None = None
    problem: str | None = None


def glance(recording: Recording) -> Glance:
    """Look at the first seconds of a recording.

    Topics that start later are looked at too if they are few: latched transforms may come late.

    Raises:
        RecordingError: the recording turns out to be damaged.
    """
    seen = {name: _Seen(problem=info.problem) for name, info in recording.topics.items() if info.count > 0}
    transforms: dict[Edge, list[tuple[float, ...]]] = {}
    readable = {name for name, state in seen.items() if state.problem is None}
    bulk = {name for name in readable if recording.topics[name].msgtype in _BULK_TYPES}
    for together in (bulk, readable - bulk):
        _look(recording, seen, transforms, together, _SECONDS)
    late = {name for name in readable if seen[name].count == 0}
    if late:
        _look(recording, {name: seen[name] for name in late}, transforms, late, None)
    topics = {
        name: _topic(recording, name, seen.get(name, _Seen(problem=info.problem)))
        for name, info in sorted(recording.topics.items())
    }
    moving = frozenset(edge for edge, values in transforms.items() if _moves(values))
    return Glance(topics, frozenset(transforms), moving)


def merge_glances(glances: Iterable[Glance]) -> Glance:
    """Return what is known of several recordings together; counts add up."""
    topics: dict[str, TopicGlance] = {}
    edges: frozenset[Edge] = frozenset()
    moving: frozenset[Edge] = frozenset()
    for one in glances:
        edges |= one.edges
        moving |= one.moving
        for name, topic in one.topics.items():
            topics[name] = _merge(topics[name], topic) if name in topics else topic
    return Glance(dict(sorted(topics.items())), edges, moving)


def _look(
    recording: Recording,
    seen: dict[str, _Seen],
    transforms: dict[Edge, list[tuple[float, ...]]],
    topics: Iterable[str],
    seconds: float | None,
) -> None:
    """Read until every topic was seen often enough, or `seconds` of log time have passed."""
    waiting = set(topics)
    until_ns: float | None = None
    for message in recording.messages(sorted(waiting)) if waiting else ():
        if until_ns is None and seconds is not None:
            until_ns = message.log_time_ns + seconds * 1e9
        if until_ns is not None and message.log_time_ns > until_ns:
            return
        state = seen[message.topic]
        if message.topic in waiting:
            _note(recording, message, state, transforms)
            most = _BULK_MESSAGES if message.msgtype in _BULK_TYPES else _MESSAGES
            if state.count >= (most if seconds is not None else _LATE_MESSAGES):
                waiting.discard(message.topic)
        if not waiting or (seconds is None and all(seen[name].count for name in waiting)):
            return


def _note(
    recording: Recording,
    message: RawMessage,
    state: _Seen,
    transforms: dict[Edge, list[tuple[float, ...]]],
) -> None:
    state.count += 1
    state.bytes = state.bytes or len(message.data)
    try:
        value = recording.decode(message)
    except DecodeError as err:
        state.problem = str(err)
        return
    header = getattr(value, "header", None)
    if header is not None:
        _note_header(message, header, state)
    child = getattr(value, "child_frame_id", None)
    if isinstance(child, str) and child.lstrip("/"):
        state.child_frames[child.lstrip("/")] = None
    kind = message.msgtype.rsplit("/", 1)[-1]
    if kind in {"TFMessage", "tfMessage"}:
        _note_transforms(value, state, transforms)
    elif kind in _PACKET_KINDS:
        _note_packet(value, state)
    elif kind == "Image":
        state.encoding = str(value.encoding)
    elif kind == "CompressedImage":
        state.encoding = str(value.format)
    elif kind == "PointCloud2":
        state.timed = bool(state.timed) or any(_is_time(str(field.name).lower()) for field in value.fields)
    elif kind == "LaserScan":
        state.timed = bool(state.timed) or float(value.time_increment) != 0.0
    elif kind == "CameraInfo":
        k = value.K if hasattr(value, "K") else value.k
        state.calibrated = bool(state.calibrated) or float(k[0]) > 0.0
    elif kind == "Imu":
        # sensor_msgs/Imu: "If you have no estimate for one of the data elements, set element 0 of the
        # associated covariance matrix to -1"; drivers without orientation also leave the quaternion zero.
        q = value.orientation
        given = float(value.orientation_covariance[0]) != -1.0 and any((q.x, q.y, q.z, q.w))
        state.oriented = bool(state.oriented) or given


def _note_header(message: RawMessage, header: Any, state: _Seen) -> None:
    frame = str(header.frame_id).lstrip("/")
    if frame:
        state.frames[frame] = None
    stamp_ns = header.stamp.sec * 1_000_000_000 + header.stamp.nanosec
    if stamp_ns == 0:
        state.zero_stamps += 1
    else:
        state.offsets_s.append((message.log_time_ns - stamp_ns) / 1e9)


def _is_time(field: str) -> bool:
    """Tell whether a field of points is their time, as far as its name says; see `bagassets.decode.point_times`."""
    return "time" in field or "stamp" in field or field.partition("_")[0] == "t"


def _note_packet(value: Any, state: _Seen) -> None:
    """Look for packets of an OxTS navigation system; see `bagassets.decode.ncom`."""
    data = value.payload if hasattr(value, "payload") else value.data
    if len(data) == 0 or len(data) % 72 or int(data[0]) != 0xE7:
        return
    address = getattr(value, "sender_ip", getattr(value, "address", ""))
    if not isinstance(address, str):
        address = ".".join(str(int(part)) for part in address)
    state.ncom_sender = state.ncom_sender or address


def _note_transforms(value: Any, state: _Seen, transforms: dict[Edge, list[tuple[float, ...]]]) -> None:
    for entry in value.transforms:
        edge = (str(entry.header.frame_id).lstrip("/"), str(entry.child_frame_id).lstrip("/"))
        state.frames[edge[0]] = None
        t, q = entry.transform.translation, entry.transform.rotation
        transforms.setdefault(edge, []).append((t.x, t.y, t.z, q.x, q.y, q.z, q.w))


def _moves(values: list[tuple[float, ...]]) -> bool:
    first = values[0]
    for value in values[1:]:
        # q and -q are the same rotation.
        sign = 1.0 if sum(a * b for a, b in zip(first[3:], value[3:], strict=True)) >= 0.0 else -1.0
        here = (*value[:3], *(sign * q for q in value[3:]))
        if max(abs(a - b) for a, b in zip(first, here, strict=True)) > _STILL_M_RAD:
            return True
    return False


def _topic(recording: Recording, name: str, state: _Seen) -> TopicGlance:
    info = recording.topics[name]
    return TopicGlance(
        name=name,
        msgtype=info.msgtype,
        count=info.count,
        problem=state.problem,
        frames=tuple(state.frames),
        child_frames=tuple(state.child_frames),
        offset_s=median(state.offsets_s) if state.offsets_s else None,
        unstamped=state.zero_stamps > 0 and not state.offsets_s,
        encoding=state.encoding,
        calibrated=state.calibrated,
        oriented=state.oriented,
        ncom_sender=state.ncom_sender,
        message_bytes=state.bytes,
        timed=state.timed,
    )


def _merge(one: TopicGlance, other: TopicGlance) -> TopicGlance:
    offsets = [value for value in (one.offset_s, other.offset_s) if value is not None]
    return TopicGlance(
        name=one.name,
        msgtype=one.msgtype,
        count=one.count + other.count,
        problem=one.problem and other.problem,
        frames=tuple(dict.fromkeys((*one.frames, *other.frames))),
        child_frames=tuple(dict.fromkeys((*one.child_frames, *other.child_frames))),
        offset_s=max(offsets, key=abs) if offsets else None,
        unstamped=one.unstamped or other.unstamped,
        encoding=one.encoding or other.encoding,
        calibrated=_any(one.calibrated, other.calibrated),
        oriented=_any(one.oriented, other.oriented),
        ncom_sender=one.ncom_sender or (one.ncom_sender if other.ncom_sender is None else other.ncom_sender),
        message_bytes=one.message_bytes or other.message_bytes,
        timed=_any(one.timed, other.timed),
    )


def _any(one: bool | None, other: bool | None) -> bool | None:
    return other if one is None else one or bool(other)
