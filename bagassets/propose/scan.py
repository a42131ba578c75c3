"""The first messages of each topic of a recording, decoded, and what they say.

Proposing a recipe needs frames, encodings and the TF tree, but not every message. Reading the
first seconds keeps `bagassets init` quick on terabytes; the inventory reads everything later.
Messages are decoded as a build decodes them, by plug-ins, too: what a build would refuse is not proposed.
"""

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from math import inf, isfinite
from statistics import median
from typing import Any

import numpy as np

from bagassets.base.errors import DecodeError, PluginError
from bagassets.decode.fields import check_points
from bagassets.decode.hesai import packet_and_model
from bagassets.decode.loading import load_decoder
from bagassets.decode.model import CloudReading, ImageReading, PoseReading, RadarReading
from bagassets.decode.ncom import holds_ncom
from bagassets.decode.packets import is_velodyne_packet, sender
from bagassets.decode.point_times import RecordedTimes, suffice, survey
from bagassets.decode.pointcloud2 import POINT_CLOUDS, read_pointcloud2, without_zero_points
from bagassets.decode.poses import decode_transform
from bagassets.decode.registry import AnyFamily, bulk_types, families_of, find_decoder
from bagassets.decode.robots import robot_of, robots_of
from bagassets.decode.video import VideoPacket, codec_in_image, decode_video_packet, decoder_version
from bagassets.geometry.se3 import SE3
from bagassets.propose.naming import is_radar_list
from bagassets.propose.poses import propose_pose
from bagassets.propose.radar_velocities import velocities_of
from bagassets.propose.sensors import find_sensors, modality_of
from bagassets.propose.signals import elements_of, says_episodes, text_in
from bagassets.propose.summary import Edge, RecordingSummary, TopicSummary, merge_topics, transform_topics
from bagassets.recipe.model import Limits, Scenes
from bagassets.recordings.heads import head_of
from bagassets.recordings.layouts import ZSTD_MAGIC
from bagassets.recordings.model import Message, RawMessage
from bagassets.recordings.recording import Recording
from bagassets.recordings.topic import ForeignBytes, Topic

Decode = Callable[..., Any]
Facts = dict[str, Any]
"""Fields of a `TopicSummary` that one message gives."""

_SECONDS = 5.0
_MESSAGES = 20
_EVENTS = 1000
_BULK_MESSAGES = 3
_LATE_MESSAGES = 3
_PATIENCE = 5  # times as many, as long as none can be used: sensors and receivers take time to start
_LIMITS = Limits()
_SHORTEST_SCENE_S = Scenes().min_length_s
# Without those that lidars have, too: some measure `velocity`.
_RADAR_FIELDS = frozenset({"doppler", "doppler_velocity", "radial_speed", "range_rate", "rcs", "v_r"})
_PNG_16_BIT = b"\x10"  # the bit depth of a PNG is its byte 24
_STILL_M_RAD = 1e-4
_STRING = "std_msgs/msg/String"
_URDF_BEGINS = re.compile(r"(?:\s|<\?.*?\?>|<!--.*?-->)*<robot\b", re.DOTALL)
_COMPRESSED = (
    "its messages are compressed, which only the metadata.yaml of its bag says; put that file beside it"
)


def scan_recording(recording: Recording) -> RecordingSummary:
    """Read the first seconds of a recording, and of topics that start later the first messages if they are few.

    Raises:
        RecordingError: the recording turns out to be damaged.
    """
    counts = recording.counts()
    scans = {name: _TopicScan(recording.topics[name], count) for name, count in counts.items() if count > 0}
    readable = {name for name, scan in scans.items() if scan.problem is None}
    bulk = {name for name in readable if recording.topics[name].msgtype in bulk_types("yes")}
    _read(recording, scans, bulk, _BULK_MESSAGES, _SECONDS)
    events = {name for name in readable if says_episodes(name, recording.topics[name].msgtype)}
    _read(recording, scans, readable - bulk - events, _MESSAGES, _SECONDS)
    _read(recording, scans, events, _EVENTS, inf)  # the first episode that is aborted may come late
    # Latched transforms may come late.
    _read(recording, scans, {name for name in readable if scans[name].count == 0}, _LATE_MESSAGES, None)
    topics = {
        name: scans[name].result() if name in scans else _summary_of(topic, 0)
        for name, topic in recording.topics.items()
    }
    robots = robots_of({name: (one.msgtype, one.frames) for name, one in topics.items() if one.count > 0})
    topics = {name: topics[name] for name in _of_first(robots, topics)}
    values: dict[Edge, list[SE3]] = {}
    for name in filter(scans.__contains__, topics):
        for edge, own in scans[name].transforms.items():
            values.setdefault(edge, []).extend(own)
    transforms = {edge: own[0] for edge, own in values.items()}
    moving = frozenset(edge for edge, own in values.items() if _moves(own))
    static_topics = [name for name in topics if "static" in name and name in scans]
    static = frozenset(edge for name in static_topics for edge in scans[name].transforms)
    sensors = {topic.name for topic in topics.values() if topic.count > 0 and modality_of(topic) is not None}
    short_s = {name: scans[name].length_s for name in sorted(sensors) if scans[name].is_short}
    summary = RecordingSummary(topics, transforms, moving, short_s, robots, static)
    radars = [sensor.topic.name for sensor in find_sensors(summary)[0] if sensor.modality == "radar"]
    pose = propose_pose(summary, "base_link").fields
    movers = [pose["topic"]] if "topic" in pose and pose["source"] != "ncom" else transform_topics(summary)
    for name, velocities in velocities_of(recording, radars, movers).items():
        topics[name] = replace(topics[name], velocities=frozenset({velocities}))
    return summary


def _of_first(robots: Mapping[str, bool], topics: Collection[str]) -> Collection[str]:
    """Return the topics of the first robot, and those of none; but `/tf` only if it has no TF of its own."""
    if not robots:
        return topics
    own = [name for name in topics if robot_of(name, robots) == next(iter(robots))]
    instead_of = {f"/{name.rpartition('/')[2]}" for name in own}
    return [*own, *(name for name in topics if robot_of(name, robots) is None and name not in instead_of)]


def point_time_notes(summary: RecordingSummary) -> list[str]:
    """Return a sentence for each lidar with PointCloud2: what the times of its points are."""
    return [
        f"{topic.name}: {topic.clock or 'its points have no times'}."
        for topic in summary.topics.values()
        if topic.msgtype in POINT_CLOUDS and topic.timed is not None and modality_of(topic) == "lidar"
    ]


def _read(
    recording: Recording,
    scans: "Mapping[str, _TopicScan]",
    topics: Collection[str],
    most: int,
    seconds: float | None,
) -> None:
    """Read until every topic gave enough messages, usually `most`, or `seconds` of log time have passed."""
    waiting = set(topics)
    until_ns: float | None = None
    for message in recording.messages(sorted(waiting)) if waiting else ():
        scan = scans[message.topic]
        scan.see(message.log_time_ns)
        if isinstance(message.data, ForeignBytes):
            scan.misfit = scan.misfit or message.data.reason
            continue
        scan.own_times_ns.append(message.log_time_ns)
        if until_ns is None and seconds is not None:
            until_ns = message.log_time_ns + seconds * 1e9
        if until_ns is not None and message.log_time_ns > until_ns:
            return
        if message.topic in waiting:
            if not scan.is_enough(most):
                scan.take(message, recording)
            if scan.is_enough(most) and (seconds is None or scan.is_short is not None):
                waiting.discard(message.topic)
        if not waiting or (seconds is None and all(scans[name].count for name in waiting)):
            return


class _TopicScan:
    """The messages of one topic that have been read so far.

    Attributes:
        problem: why no message can be decoded.
        misfit: why a message could not be decoded.
        count: messages decoded or tried, but for those of another type than the topic.
        transforms: edge -> the values that it had.
        length_s: time between the first and the last message that were read.
        own_times_ns: log times of its own messages.
    """

    def __init__(self, topic: Topic, count: int) -> None:
        self.problem = topic.problem
        self.misfit: str | None = None
        self.count = self._decoded = self._seen = self._first_ns = 0
        self.length_s = 0.0
        self.own_times_ns: list[int] = []
        self._summary = _summary_of(topic, count)
        self.transforms: dict[Edge, list[SE3]] = {}
        self._takers = {**_FACTS, "cloud": self._take_cloud, "transforms": self._take_transforms}
        self._decoders: dict[AnyFamily, Decode] = {}
        # Reads on if nothing can be used: the type itself says what its messages are.
        self._is_patient = False
        self._usable = 0
        self._refusal: str | None = None
        self._offsets_s: list[float] = []
        self._has_unset_stamps = False
        self._recorded: list[RecordedTimes] = []

    def see(self, log_time_ns: int) -> None:
        """Note the time of a message, decoded or not."""
        self._first_ns = self._first_ns if self._seen else log_time_ns
        self.length_s = (log_time_ns - self._first_ns) / 1e9
        self._seen += 1

    @property
    def is_short(self) -> bool | None:
        """Whether the recording has too little of the topic for a scene; None if it is not known yet."""
        if self.length_s >= _SHORTEST_SCENE_S:
            return False
        return True if self._seen == self._summary.count else None

    def is_enough(self, most: int) -> bool:
        """Tell whether enough messages were read; more of them as long as none can be used."""
        if self._recorded and self.count >= most:
            return suffice(self._recorded)
        return self.count >= (_PATIENCE * most if self._is_patient and not self._usable else most)

    def take(self, message: RawMessage, recording: Recording) -> None:
        """Decode one message."""
        if not self.count:
            self._find_decoders(message.msgtype)
        self.count += 1
        try:
            value = recording.decode(message)
        except DecodeError as err:
            self.misfit = self.misfit or (_COMPRESSED if message.data[:4] == ZSTD_MAGIC else str(err))
            return
        self._decoded += 1
        if message.msgtype == _STRING and _URDF_BEGINS.match(value.data):
            self._add({"urdf": value.data})
        elements, text = elements_of(value, message.msgtype), text_in(value, message.msgtype)
        if elements or text:
            self._add({"elements": (elements,) if elements else (), "texts": (text,) if text else ()})
        if (found := head_of(value)) is not None:
            self._take_head(message, *found)
        reasons = []
        for family, decode in self._decoders.items():
            facts: Facts = {}
            try:
                self._takers[family](facts, decode, value, message.msgtype)
            except DecodeError as err:
                reasons.append(str(err))
            self._add(facts)
        self._has_unset_stamps |= "ouster" in self._decoders
        if len(reasons) < len(self._decoders):
            self._usable += 1
        elif reasons:
            self._refusal = self._refusal or reasons[0]

    def result(self) -> TopicSummary:
        """Return what the messages said."""
        clock = survey(self._recorded) if self._recorded else None
        return replace(
            self._summary,
            timed=self._summary.timed if clock is None else not clock.problem,
            clock=clock,
            problem=self.problem or (None if self._decoded else self.misfit),
            offset_s=median(self._offsets_s) if self._offsets_s else None,
            unstamped=self._has_unset_stamps and not self._offsets_s,
            rate_hz=_rate_hz(self.own_times_ns),
            refusal=None if self._usable else self._refusal,
        )

    def _find_decoders(self, msgtype: str) -> None:
        """Import what reads a type; what goes by fields is tried on radar lists and on everything else."""
        families = families_of(msgtype) or (("radar",) if is_radar_list(msgtype) else ("packets",))
        for family in families:
            try:
                decoder = find_decoder(family, msgtype)
                if decoder is not None and family in self._takers:
                    self._decoders[family] = load_decoder(decoder)
                    self._is_patient |= not decoder.by_fields
            except PluginError as err:
                self._refusal = str(err)

    def _add(self, facts: Facts) -> None:
        base = TopicSummary(self._summary.name, self._summary.msgtype, 0)
        frames = tuple(frame for frame in facts.pop("frames", ()) if frame)
        self._summary = merge_topics(self._summary, replace(base, frames=frames, **facts))

    def _take_head(self, message: RawMessage, stamp_ns: int, frame: str) -> None:
        self._add({"frames": (frame,)})
        if stamp_ns == 0:
            self._has_unset_stamps = True
        else:
            self._offsets_s.append((message.log_time_ns - stamp_ns) / 1e9)

    def _take_cloud(self, facts: Facts, decode: Decode, value: Message, msgtype: str) -> None:
        check_points(value, _LIMITS.cloud_points)
        reading: CloudReading
        if msgtype in POINT_CLOUDS:
            names = (field.name.lower() for field in getattr(value, "fields", ()))
            facts["is_of_radar"] = not _RADAR_FIELDS.isdisjoint(names)
            reading = without_zero_points(read_pointcloud2(value))
            intensities = reading.points[:, 3]
            if ((intensities > 0.0) & (intensities != 1.0)).any():  # ones and zeros may be anything
                facts["most_intensity"] = float(intensities.max())
            self._recorded += [] if reading.recorded is None else [reading.recorded]
        else:
            reading = decode(value, None, "end")
        facts["frames"] = (reading.frame_id,)
        if len(reading.points) > 1:  # times that do not differ are none
            facts["timed"] = reading.times_ns is not None

    def _take_transforms(self, facts: Facts, decode: Decode, value: Message, _msgtype: str) -> None:
        facts["frames"] = []
        for stamped in decode(value):
            try:
                reading = decode_transform(stamped)
            except DecodeError as err:
                self._refusal = self._refusal or str(err)
                continue
            facts["frames"].append(reading.parent)
            edge = (reading.parent, reading.child)
            self.transforms.setdefault(edge, []).append(reading.parent_SE3_child)


def _rate_hz(times_ns: Sequence[int]) -> float | None:
    steps_ns = np.diff(sorted(times_ns))
    return 1e9 / float(np.median(steps_ns)) if len(steps_ns) and np.median(steps_ns) > 0 else None


def _summary_of(topic: Topic, count: int) -> TopicSummary:
    return TopicSummary(topic.name, topic.msgtype, count, topic.problem)


# Each of these puts into `facts` what a message says, those before the decoder refuses it, too.


def _image(facts: Facts, decode: Decode, value: Message, msgtype: str) -> None:
    if codec_in_image(value, msgtype) is not None:
        _video(facts, decode_video_packet, value, msgtype)
        return
    reading: ImageReading = decode(value)
    if reading.pixels is not None:
        is_16_bit = bool(reading.pixels.dtype != np.uint8)
    else:
        is_16_bit = reading.encoding.startswith("rvl") or (
            reading.encoding.startswith("png") and bytes((reading.encoded or b"")[24:25]) == _PNG_16_BIT
        )
    facts |= {"frames": (reading.frame_id,), "encoding": reading.encoding, "is_16_bit": is_16_bit}


def _video(facts: Facts, decode: Decode, value: Message, _msgtype: str) -> None:
    packet: VideoPacket = decode(value)
    facts |= {"frames": (packet.frame_id,), "encoding": packet.codec, "is_16_bit": False}
    decoder_version("its pictures")


def _radar(facts: Facts, decode: Decode, value: Message, msgtype: str) -> None:
    check_points(value, _LIMITS.cloud_points)
    reading: RadarReading = decode(value, msgtype, None)
    facts["frames"] = (reading.frame_id,)


def _pose(facts: Facts, decode: Decode, value: Message, _msgtype: str) -> None:
    reading: PoseReading = decode(value)
    if reading.child:
        facts["child_frames"] = (reading.child,)


def _fix(_facts: Facts, decode: Decode, value: Message, _msgtype: str) -> None:
    decode(value)


def _imu(facts: Facts, decode: Decode, value: Message, _msgtype: str) -> None:
    facts["oriented"] = False
    measured = getattr(value, "linear_acceleration", None)
    covariance = getattr(value, "linear_acceleration_covariance", (0.0,))
    if measured is not None and covariance[0] != -1:  # REP 145: -1 where nothing is measured
        acceleration = (float(measured.x), float(measured.y), float(measured.z))
        if all(map(isfinite, acceleration)):
            facts["acceleration"] = acceleration
    decode(value)
    facts["oriented"] = True


def _camera_info(facts: Facts, decode: Decode, value: Message, _msgtype: str) -> None:
    facts["calibrated"] = False
    decode(value)
    facts["calibrated"] = True


def _packets(facts: Facts, decode: Decode, value: Message, _msgtype: str) -> None:
    packets = decode(value)
    facts["packets_of"] = ""
    for _own_stamp, data in packets:
        make = "Velodyne" if is_velodyne_packet(data) else "Hesai" if packet_and_model(data) else ""
        facts["packets_of"] = facts["packets_of"] or make
        facts["timed"] = bool(facts["packets_of"]) or None
        if holds_ncom(data):
            facts["ncom_sender"] = facts.get("ncom_sender") or sender(value)[0]


def _ouster(facts: Facts, decode: Decode, value: Message, _msgtype: str) -> None:
    decode(value)
    facts["timed"] = True


_FACTS: Mapping[AnyFamily, Callable[[Facts, Decode, Message, str], None]] = {
    "image": _image,
    "video": _video,
    "radar": _radar,
    "pose": _pose,
    "fix": _fix,
    "imu": _imu,
    "camera_info": _camera_info,
    "ouster": _ouster,
    "packets": _packets,
}


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
