"""A glance at a recording: its topics, and what the first few messages of each say.

Proposing a recipe needs frames, encodings and the TF tree, but not every message. Reading the
first seconds keeps `bagassets init` quick on terabytes; the inventory reads everything later.
Messages are decoded as a build decodes them, by plug-ins, too: what a build would refuse is not proposed.
"""

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field
from statistics import median
from typing import Any

import numpy as np

from bagassets.decode.fields import check_points, stamp_and_frame
from bagassets.decode.loading import load_decoder
from bagassets.decode.model import CloudReading, ImageReading, PoseReading, RadarReading
from bagassets.decode.ncom import holds_ncom
from bagassets.decode.packets import is_velodyne_packet, sender
from bagassets.decode.registry import AnyFamily, bulk_types, families_of, find_decoder
from bagassets.decode.tf import decode_transform
from bagassets.errors import DecodeError, PluginError
from bagassets.geometry.se3 import SE3
from bagassets.propose.naming import is_radar_list
from bagassets.recipe.model import Limits
from bagassets.recordings.model import RawMessage
from bagassets.recordings.recording import Recording
from bagassets.recordings.topic import Topic

__all__ = ["Glance", "TopicGlance", "glance", "merge_glances"]

Edge = tuple[str, str]
"""Parent and child frame, without leading slash."""

Decode = Callable[..., Any]

_SECONDS = 5.0
_MESSAGES = 20
_BULK_MESSAGES = 3
_LATE_MESSAGES = 3
_PATIENCE = 5  # times as many, as long as none can be used: sensors and receivers take time to start
_LIMITS = Limits()
_PNG_16_BIT = b"\x10"  # the bit depth of a PNG is its byte 24
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
        encoding: encoding of images, `jpeg` or `png` of compressed ones, as of `ImageReading`.
        is_16_bit: images have more than 8 bit a channel; None for other types.
        calibrated: a CameraInfo with usable numbers was seen; None for other types.
        oriented: an Imu gives orientation; None for other types.
        ncom_sender: IPv4 address that OxTS NCOM packets come from; "" if there are some but the
            messages do not tell; None if there are none.
        velodyne: data packets of a Velodyne were seen; None if the type holds no packets.
        timed: the points of a cloud or the rays of a scan have times; None for other types.
        refusal: why none of the messages seen is what its type is there for, in words; None if one is, or nothing
            is made of the type.
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
    ncom_sender: str | None = None
    velodyne: bool | None = None
    timed: bool | None = None
    refusal: str | None = None


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
    """What accumulates about a topic while messages pass.

    Attributes:
        problem: why messages cannot be decoded.
        transforms: takes the transforms of all topics.
        decoders: family -> what reads messages of the topic's type.
        is_patient: whether to look longer if nothing can be used: the type itself says what its messages are.
        count: messages seen.
        usable: those that a decoder could use.
        refusal: why the first of the others could not be used.
    """

    problem: str | None = None
    transforms: dict[Edge, list[SE3]] = field(default_factory=dict)
    decoders: dict[AnyFamily, Decode] = field(default_factory=dict)
    is_patient: bool = False
    count: int = 0
    usable: int = 0
    refusal: str | None = None
    offsets_s: list[float] = field(default_factory=list)
    zero_stamps: int = 0
    frames: dict[str, None] = field(default_factory=dict)
    child_frames: dict[str, None] = field(default_factory=dict)
    encoding: str | None = None
    is_16_bit: bool | None = None
    calibrated: bool | None = None
    oriented: bool | None = None
    ncom_sender: str | None = None
    velodyne: bool | None = None
    timed: bool | None = None

    def find_decoders(self, msgtype: str) -> None:
        """Import what reads a type; what goes by fields is tried on radar lists and on everything else."""
        families = families_of(msgtype) or (("radar",) if is_radar_list(msgtype) else ("packets",))
        for family in families:
            try:
                decoder = find_decoder(family, msgtype)
                if decoder is not None and family in _NOTES:
                    self.decoders[family] = load_decoder(decoder)
                    self.is_patient |= not decoder.by_fields
            except PluginError as err:
                self.refusal = str(err)

    def is_enough(self, most: int) -> bool:
        """Tell whether enough messages were seen; more of them as long as none can be used."""
        return self.count >= (_PATIENCE * most if self.is_patient and not self.usable else most)

    def note_header(self, message: RawMessage, header: Any) -> None:
        """Take frame and stamp of a message."""
        stamp_ns, frame = stamp_and_frame(header)
        self._note_frame(frame)
        if stamp_ns == 0:
            self.zero_stamps += 1
        else:
            self.offsets_s.append((message.log_time_ns - stamp_ns) / 1e9)

    def note(self, value: Any, msgtype: str) -> None:
        """Take what the decoders make of a message."""
        reasons = []
        for family, decode in self.decoders.items():
            try:
                _NOTES[family](self, decode, value, msgtype)
            except DecodeError as err:
                reasons.append(str(err))
        if len(reasons) < len(self.decoders):
            self.usable += 1
        elif reasons:
            self.refusal = self.refusal or reasons[0]

    def glance(self, topic: Topic) -> TopicGlance:
        """Return what is known of the topic."""
        return TopicGlance(
            name=topic.name,
            msgtype=topic.msgtype,
            count=topic.count,
            problem=self.problem,
            frames=tuple(self.frames),
            child_frames=tuple(self.child_frames),
            offset_s=median(self.offsets_s) if self.offsets_s else None,
            unstamped=self.zero_stamps > 0 and not self.offsets_s,
            encoding=self.encoding,
            is_16_bit=self.is_16_bit,
            calibrated=self.calibrated,
            oriented=self.oriented,
            ncom_sender=self.ncom_sender,
            velodyne=self.velodyne,
            timed=self.timed,
            refusal=None if self.usable else self.refusal,
        )

    def _note_frame(self, frame: str) -> None:
        if frame:
            self.frames[frame] = None

    def note_image(self, decode: Decode, value: Any, _: str) -> None:
        reading: ImageReading = decode(value)
        if reading.pixels is not None:
            is_16_bit = reading.pixels.dtype == np.uint16
        else:
            is_16_bit = reading.encoding == "png" and bytes((reading.encoded or b"")[24:25]) == _PNG_16_BIT
        self._note_frame(reading.frame_id)
        self.encoding = reading.encoding
        self.is_16_bit = bool(self.is_16_bit) or is_16_bit

    def note_cloud(self, decode: Decode, value: Any, _: str) -> None:
        check_points(value, _LIMITS.cloud_points)
        reading: CloudReading = decode(value, None, "end")
        self._note_frame(reading.frame_id)
        if len(reading.points) > 1:  # times that do not differ are none
            self.timed = bool(self.timed) or reading.times_ns is not None

    def note_radar(self, decode: Decode, value: Any, msgtype: str) -> None:
        check_points(value, _LIMITS.cloud_points)
        reading: RadarReading = decode(value, msgtype, None)
        self._note_frame(reading.frame_id)

    def note_pose(self, decode: Decode, value: Any, _: str) -> None:
        reading: PoseReading = decode(value)
        if reading.child:
            self.child_frames[reading.child] = None

    def note_fix(self, decode: Decode, value: Any, _: str) -> None:
        decode(value)

    def note_imu(self, decode: Decode, value: Any, _: str) -> None:
        self.oriented = bool(self.oriented)
        decode(value)
        self.oriented = True

    def note_camera_info(self, decode: Decode, value: Any, _: str) -> None:
        self.calibrated = bool(self.calibrated)
        decode(value)
        self.calibrated = True

    def note_packets(self, decode: Decode, value: Any, _: str) -> None:
        self.velodyne = bool(self.velodyne)
        for _own_stamp, data in decode(value):
            self.velodyne = self.velodyne or is_velodyne_packet(data)
            if holds_ncom(data):
                self.ncom_sender = self.ncom_sender or sender(value)[0]

    def note_transforms(self, decode: Decode, value: Any, _: str) -> None:
        for stamped in decode(value):
            try:
                reading = decode_transform(stamped)
            except DecodeError as err:
                self.refusal = self.refusal or str(err)
                continue
            self._note_frame(reading.parent)
            edge = (reading.parent, reading.child)
            self.transforms.setdefault(edge, []).append(reading.parent_SE3_child)


_NOTES: Mapping[AnyFamily, Callable[[_Seen, Decode, Any, str], None]] = {
    "image": _Seen.note_image,
    "cloud": _Seen.note_cloud,
    "radar": _Seen.note_radar,
    "pose": _Seen.note_pose,
    "fix": _Seen.note_fix,
    "imu": _Seen.note_imu,
    "camera_info": _Seen.note_camera_info,
    "packets": _Seen.note_packets,
    "transforms": _Seen.note_transforms,
}


def glance(recording: Recording) -> Glance:
    """Look at the first seconds of a recording.

    Topics that start later are looked at too if they are few: latched transforms may come late.

    Raises:
        RecordingError: the recording turns out to be damaged.
    """
    look = _Look(recording)
    readable = {name for name, seen in look.seen.items() if seen.problem is None}
    bulk = {name for name in readable if recording.topics[name].msgtype in look.bulk}
    for together in (bulk, readable - bulk):
        look.at(together, _SECONDS)
    look.at({name for name in readable if look.seen[name].count == 0}, None)
    topics = {
        name: look.seen[name].glance(topic)
        if name in look.seen
        else _Seen(problem=topic.problem).glance(topic)
        for name, topic in recording.topics.items()
    }
    moving = frozenset(edge for edge, values in look.transforms.items() if _moves(values))
    return Glance(topics, frozenset(look.transforms), moving)


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


class _Look:
    """A look at the messages of a recording.

    Attributes:
        seen: what was seen of each topic that has messages.
        transforms: edge -> the values that it had.
        bulk: types of which few messages are read.
    """

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self.transforms: dict[Edge, list[SE3]] = {}
        self.bulk = bulk_types("yes")
        self.seen = {
            name: _Seen(topic.problem, transforms=self.transforms)
            for name, topic in recording.topics.items()
            if topic.count > 0
        }

    def at(self, topics: Collection[str], seconds: float | None) -> None:
        """Read until every topic was seen often enough, or `seconds` of log time have passed."""
        waiting = set(topics)
        until_ns: float | None = None
        for message in self._recording.messages(sorted(waiting)) if waiting else ():
            if until_ns is None and seconds is not None:
                until_ns = message.log_time_ns + seconds * 1e9
            if until_ns is not None and message.log_time_ns > until_ns:
                return
            seen = self.seen[message.topic]
            if message.topic in waiting:
                self._note(message, seen)
                most = _BULK_MESSAGES if message.msgtype in self.bulk else _MESSAGES
                if seen.is_enough(most if seconds is not None else _LATE_MESSAGES):
                    waiting.discard(message.topic)
            if not waiting or (seconds is None and all(self.seen[name].count for name in waiting)):
                return

    def _note(self, message: RawMessage, seen: _Seen) -> None:
        if not seen.count:
            seen.find_decoders(message.msgtype)
        seen.count += 1
        try:
            value = self._recording.decode(message)
        except DecodeError as err:
            seen.problem = str(err)
            return
        if hasattr(value, "header"):
            seen.note_header(message, value.header)
        seen.note(value, message.msgtype)


def _moves(values: list[SE3]) -> bool:
    first = values[0]
    for value in values[1:]:
        # q and -q are the same rotation.
        sign = 1.0 if sum(a * b for a, b in zip(first.rotation, value.rotation, strict=True)) >= 0.0 else -1.0
        there = (*first.translation, *first.rotation)
        here = (*value.translation, *(sign * q for q in value.rotation))
        if max(abs(a - b) for a, b in zip(there, here, strict=True)) > _STILL_M_RAD:
            return True
    return False


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
        is_16_bit=_any(one.is_16_bit, other.is_16_bit),
        calibrated=_any(one.calibrated, other.calibrated),
        oriented=_any(one.oriented, other.oriented),
        ncom_sender=one.ncom_sender or (one.ncom_sender if other.ncom_sender is None else other.ncom_sender),
        velodyne=_any(one.velodyne, other.velodyne),
        timed=_any(one.timed, other.timed),
        refusal=one.refusal and other.refusal,
    )


def _any(one: bool | None, other: bool | None) -> bool | None:
    return other if one is None else one or bool(other)
