"""One rig of a proposed recipe: its channels, frames, clock, poses and boxes."""

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from bagassets.base.errors import CalibrationError
from bagassets.base.quantities import span_text
from bagassets.decode.registry import types_of
from bagassets.geometry.urdf import urdf_edges
from bagassets.propose.frames import EgoFrame, connected, propose_ego_frame
from bagassets.propose.grouping import Group
from bagassets.propose.naming import channel_name, free_name, tokens, word_set
from bagassets.propose.poses import PoseProposal, odometry_of, propose_pose
from bagassets.propose.sensors import Sensor, find_sensors, has_ouster_packets, metadata_of
from bagassets.propose.signals import SignalProposal, find_signals, is_of_tool, said_in, word_on
from bagassets.propose.summary import USES, RecordingSummary, TopicSummary, TopicUse, transform_topics

_LARGE_OFFSET_S = 1.0
# Poses may be computed seconds after what they are of was measured.
_LATE_POSE_S = 10.0
# From a reading to its log; longer, the clock of the stamps may not be that of the log.
_LATENCY_S = 0.25
_MARKERS = "visualization_msgs/"  # for whatever somebody wants to see in three dimensions, seldom for boxes
_BOXES = word_set("bboxes boxes detections objects")
_TRUTH = word_set("annotation annotations gt ground groundtruth label labels labelled truth")


@dataclass(frozen=True)
class ClockProposal:
    """Which time of messages counts; `reason` is empty if nothing spoke against the usual one.

    `odd`: topics whose stamps are of another clock than those of the others.
    """

    clock: Literal["header", "log"]
    reason: str = ""
    odd: frozenset[str] = frozenset()


@dataclass(frozen=True)
class RigProposal:
    """A rig before it is written down.

    Attributes:
        name: rig name.
        match: globs of its recordings.
        recordings: the recordings looked into, paths below the bag root.
        ego: the ego frame.
        clock: which time of messages counts.
        pose: the pose source.
        channels: channel -> sensor.
        reasons: channel -> how its name was found.
        annotations: topics with boxes, the one to use first.
        left_out: topics that could be a sensor's.
        summary: what the recordings hold, with the joints of the URDF.
        urdf: a robot description that is used as the rig's URDF, or left out as it places no sensor; None if TF places all.
        signals: its signals, if it has no lidar or radar.
        needs_poses: another rig is that of a vehicle, whose dataset asks for the poses of all.
    """

    name: str
    match: list[str]
    recordings: tuple[str, ...]
    ego: EgoFrame
    clock: ClockProposal
    pose: PoseProposal
    channels: dict[str, Sensor]
    reasons: dict[str, str]
    annotations: list[str]
    left_out: list[TopicUse]
    summary: RecordingSummary
    urdf: TopicUse | None = None
    signals: Sequence[SignalProposal] = ()
    needs_poses: bool = False

    @property
    def is_arm(self) -> bool:
        """True if it has signals and no poses but those of a tool, so that only its signals and images make a dataset."""
        source, topic = (self.pose.fields.get(field, "") for field in ("source", "topic"))
        is_fixed = source in {"", "tf"} or (source == "pose" and is_of_tool(self.summary.topics[topic]))
        return bool(self.signals) and not self.needs_poses and is_fixed

    @property
    def topic_uses(self) -> list[TopicUse]:
        """What becomes of each topic."""
        pose = PoseProposal() if self.is_arm else self.pose
        return uses_of(
            self.summary, self.channels, pose, self.annotations, self.left_out, self.urdf, self.signals
        )


def propose_rig(
    group: Group, match: list[str], taken: Collection[str], *, urdfs: bool = False
) -> RigProposal:
    """Return the rig that made a group of recordings.

    Args:
        group: the recordings.
        match: globs that match them.
        taken: names of other rigs.
        urdfs: a robot description that was recorded may be written to a file, and be the rig's URDF.
    """
    summary = group.summary
    sensors, left_out = find_sensors(summary)
    ego = propose_ego_frame(summary, sensors, odometry_of(summary))
    urdf: TopicUse | None = None
    description = next((topic for topic in summary.topics.values() if topic.urdf), None)
    if description is not None:
        try:
            more = _described(summary, description.urdf)
        except CalibrationError as err:
            left_out.append(TopicUse(description, "left out", str(err)))
        else:
            other = propose_ego_frame(more, sensors, odometry_of(more))
            placed = _placed(summary, ego, sensors)
            if _placed(more, other, sensors) > placed and not urdfs:
                why = "a URDF that says where sensors are; `bagassets init` uses it, as a file beside the recipe"
                left_out.append(TopicUse(description, "left out", why))
            elif _placed(more, other, sensors) > placed:
                summary, ego, urdf = more, other, TopicUse(description, "used", "URDF")
            elif urdfs and placed < (len(sensors), True):
                urdf = TopicUse(
                    description, "left out", "a URDF that places no sensor; a comment in the recipe"
                )
    pose = propose_pose(summary, ego.name, group.pose_sources or None)
    has_only_cameras = all(one.modality == "camera" for one in sensors)
    signals = find_signals(summary, cameras=bool(sensors)) if has_only_cameras else []
    clock = _clock(sensors, signals, summary.topics.get(pose.fields.get("topic", "")))
    signals = [replace(one, by_log_time=one.by_log_time or one.topic.name in clock.odd) for one in signals]
    rig = RigProposal(
        name=_rig_name(match, taken, next(iter(summary.robots), "")),
        match=match,
        recordings=group.recordings,
        ego=ego,
        clock=clock,
        pose=pose,
        channels={},
        reasons={},
        annotations=boxes_in(summary),
        left_out=left_out,
        summary=summary,
        urdf=urdf,
        signals=signals,
    )
    for sensor in sensors:
        alone = sum(other.modality == sensor.modality for other in sensors) == 1
        topic, named = sensor.topic, rig.channels
        name, reason = channel_name(sensor.modality, topic.name, topic.frames, named, alone, rig.is_arm)
        rig.channels[name], rig.reasons[name] = sensor, reason
    return rig


def _described(summary: RecordingSummary, urdf: str) -> RecordingSummary:
    """Return recordings with the fixed joints of a URDF, as robot_state_publisher latches it, where it puts what TF does not.

    Builds lay them between `/tf_static` and `/tf`, too.

    Raises:
        CalibrationError: the URDF cannot be used.
    """
    known = {child for _, child in summary.static}
    joints = {
        (edge.parent, edge.child): edge.first for edge in urdf_edges(urdf.encode()) if edge.child not in known
    }
    return replace(
        summary,
        transforms={**summary.transforms, **joints},
        moving=summary.moving - joints.keys(),
        static=summary.static | joints.keys(),
    )


def _placed(summary: RecordingSummary, ego: EgoFrame, sensors: Sequence[Sensor]) -> tuple[int, bool]:
    """Return for how many sensors it is known where they sit, and whether that is in a frame of the vehicle."""
    frames = [frame for sensor in sensors for frame in sensor.topic.frames[:1]]
    return sum(connected(summary.edges, ego.name, frame) for frame in frames), not ego.is_sensor


def boxes_in(summary: RecordingSummary) -> list[str]:
    """Return topics with boxes: those that look like truth first, markers last, then by number of messages."""
    found: list[tuple[bool, bool, int, str]] = []
    for topic in summary.topics.values():
        words, is_drawn = tokens(topic.name), topic.msgtype.startswith(_MARKERS)
        is_truth = not _TRUTH.isdisjoint(words)
        if topic.count == 0 or topic.problem is not None or topic.msgtype not in types_of("boxes"):
            continue
        if is_truth or not is_drawn or not _BOXES.isdisjoint(words[-1:]):
            found.append((not is_truth, is_drawn, -topic.count, topic.name))
    return [name for *_, name in sorted(found)]


def _clock(
    sensors: Sequence[Sensor], signals: Sequence[SignalProposal], poses: TopicSummary | None
) -> ClockProposal:
    """Propose the time by which sensors, signals and poses fit together."""
    topics = [sensor.topic for sensor in sensors]
    unset = sorted(topic.name for topic in topics if topic.unstamped)
    are_zero = any(topic.unstamped and not has_ouster_packets(topic) for topic in topics)
    offsets = {topic.name: topic.offset_s for topic in topics if topic.offset_s is not None}
    # Sensors with stamps keep them beside one without, if the log has nearly the same time.
    if unset and not (offsets and all(0 <= offset_s <= _LATENCY_S for offset_s in offsets.values())):
        return ClockProposal(
            "log", f"header stamps of {', '.join(unset[:3])} are {'zero' if are_zero else 'missing'}"
        )
    offsets |= {one.topic.name: one.topic.offset_s for one in signals if one.topic.offset_s is not None}
    if not offsets:
        return ClockProposal("header")
    late_s = None if poses is None else poses.offset_s
    if poses and late_s is not None and min(abs(late_s - one) for one in offsets.values()) > _LATE_POSE_S:
        offsets[poses.name] = late_s
    latest, earliest = max(offsets, key=offsets.__getitem__), min(offsets, key=offsets.__getitem__)
    apart_s = offsets[latest] - offsets[earliest]
    if apart_s > _LARGE_OFFSET_S:
        reason = f"header stamps of {earliest} and {latest} are {span_text(apart_s)} apart"
        odd = frozenset(name for name, offset_s in offsets.items() if not 0 <= offset_s <= _LATENCY_S)
        # Of those to which the log is near the stamps count, also beside others by log time.
        if len(odd) < len(offsets) and 0 <= (late_s or 0) <= _LATE_POSE_S:
            return ClockProposal(
                "header", f"{reason}; those of another clock than the log have `clock: log`", odd
            )
        return ClockProposal("log", reason)
    name, offset_s = max(offsets.items(), key=lambda entry: abs(entry[1]))
    if abs(offset_s) <= _LARGE_OFFSET_S:
        return ClockProposal("header")
    side = "after" if offset_s > 0 else "before"
    return ClockProposal(
        "header",
        f"the header stamps agree, though {name} was logged {abs(offset_s):.1f} s {side} its stamp; "
        "`log` is the other choice",
    )


def _rig_name(match: list[str], taken: Collection[str], robot: str) -> str:
    if match == ["**"] and not robot:
        name = "rig"
    else:
        stem = (robot or match[0].removesuffix("/**")).rsplit("/", 1)[-1]
        stem = re.sub(r"\.(bag|mcap|db3)$", "", stem)
        name = re.sub(r"[^A-Za-z0-9_.-]+", "-", stem).strip("-._") or "rig"
    return free_name(name, taken, "-")


def uses_of(
    summary: RecordingSummary,
    channels: Mapping[str, Sensor],
    pose: PoseProposal,
    annotations: list[str],
    left_out: list[TopicUse],
    urdf: TopicUse | None = None,
    signals: Sequence[SignalProposal] = (),
) -> list[TopicUse]:
    """Return what becomes of each topic: used as what, not decodable and why, or not needed; those that are used first.

    Args:
        summary: the recordings.
        channels: channel -> sensor.
        pose: where poses come from.
        annotations: topics with boxes, the one that is used first.
        left_out: topics that could be a sensor's.
        urdf: what becomes of a robot description.
        signals: the signals.
    """
    used: dict[str, list[str]] = {}
    for name, sensor in channels.items():
        used.setdefault(sensor.topic.name, []).append(name)
        if sensor.camera_info is not None:
            used.setdefault(sensor.camera_info.name, []).append(f"calibration of {name}")
        if (described := metadata_of(sensor.topic, summary)) is not None:
            used.setdefault(described, []).append(f"metadata of {name}")
    for field, what in (("topic", "poses"), ("imu", "orientation")):
        if field in pose.fields:
            used.setdefault(pose.fields[field], []).append(what)
    for signal in signals:
        used.setdefault(signal.topic.name, []).append(f"signal {signal.name}")
    for name, what in said_in(summary).items() if signals else ():
        used.setdefault(name, []).append(what)
    for name in annotations[:1]:
        used.setdefault(name, []).append("boxes")
    for name in transform_topics(summary):
        used.setdefault(name, []).append("transforms")
    uses = [TopicUse(summary.topics[name], "used", ", ".join(what)) for name, what in used.items()]
    uses += left_out if urdf is None else [*left_out, urdf]
    known = {use.topic.name for use in uses}
    boxes = "boxes, too; the recipe has it as a comment"
    left = {
        name: word
        for name, topic in summary.topics.items()
        if topic.count and (channels or signals) and (word := word_on(topic, beside_signals=bool(signals)))
    } | dict.fromkeys(annotations, boxes)
    if channels or signals:
        for name in transform_topics(summary, decodable=False):
            left[name] = f"transforms that cannot be decoded: {summary.topics[name].problem}"
    uses += [
        TopicUse(topic, "left out" if name in left else "not needed", left.get(name, ""))
        for name, topic in summary.topics.items()
        if name not in known
    ]
    return sorted(uses, key=lambda use: USES.index(use.status))
