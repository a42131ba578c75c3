"""One rig of a proposed recipe: its channels, frames, poses and boxes."""

import re
from collections.abc import Collection
from dataclasses import dataclass

from bagassets.decode.registry import types_of
from bagassets.escaping import yaml_scalar
from bagassets.propose.commented_yaml import Sheet
from bagassets.propose.glance import Glance
from bagassets.propose.grouping import Group
from bagassets.propose.naming import channel_name, tokens, word_set
from bagassets.propose.poses import EgoFrame, PoseProposal, connected, propose_ego_frame, propose_pose
from bagassets.propose.sensors import Sensor, find_sensors

__all__ = ["RigProposal", "propose_rig", "write_rig"]

_MARKERS = "visualization_msgs/"  # for whatever somebody wants to see in three dimensions, seldom for boxes
_TRUTH = word_set("annotation annotations gt ground groundtruth label labels labelled truth")


@dataclass(frozen=True)
class RigProposal:
    """A rig before it is written down.

    Attributes:
        name: rig name.
        match: globs of its recordings.
        recordings: number of recordings looked at.
        ego: the ego frame.
        pose: the pose source.
        channels: channel -> sensor.
        reasons: channel -> how its name was found.
        annotations: topics with boxes, the one to use first.
        left_out: topics that were not taken, with the reason.
        glance: what is known of the recordings.
    """

    name: str
    match: list[str]
    recordings: int
    ego: EgoFrame
    pose: PoseProposal
    channels: dict[str, Sensor]
    reasons: dict[str, str]
    annotations: list[str]
    left_out: list[tuple[str, str]]
    glance: Glance


def propose_rig(group: Group, match: list[str], taken: Collection[str]) -> RigProposal:
    """Return the rig that made a group of recordings.

    Args:
        group: the recordings.
        match: globs that match them.
        taken: names of other rigs.
    """
    sensors, left_out = find_sensors(group.glance)
    channels: dict[str, Sensor] = {}
    reasons: dict[str, str] = {}
    for sensor in sensors:
        alone = sum(other.modality == sensor.modality for other in sensors) == 1
        name, reason = channel_name(sensor.modality, sensor.topic.name, sensor.topic.frames, channels, alone)
        channels[name], reasons[name] = sensor, reason
    frames = [frame for sensor in sensors for frame in sensor.topic.frames]
    ego = propose_ego_frame(group.glance, frames)
    return RigProposal(
        name=_rig_name(match, taken),
        match=match,
        recordings=len(group.recordings),
        ego=ego,
        pose=propose_pose(group.glance, ego.name),
        channels=channels,
        reasons=reasons,
        annotations=_annotations(group.glance),
        left_out=left_out,
        glance=group.glance,
    )


def write_rig(sheet: Sheet, rig: RigProposal) -> None:
    """Write a rig below `rigs:`."""
    plural = "s" if rig.recordings != 1 else ""
    sheet.field(1, f"- name: {yaml_scalar(rig.name)}", f"{rig.recordings} recording{plural}")
    if rig.match != ["**"]:
        if len(rig.match) == 1:
            sheet.field(2, f"match: [{yaml_scalar(rig.match[0])}]")
        else:
            sheet.field(2, "match:")
            for glob in rig.match:
                sheet.field(3, f"- {yaml_scalar(glob)}")
    reason = (
        f"guess: {rig.ego.reason}"
        if rig.ego.reason
        else "not guessed: the usual name, not seen in the recordings"
    )
    sheet.field(2, f"ego_frame: {yaml_scalar(rig.ego.name)}", reason)
    _write_pose(sheet, rig)
    sheet.field(2, "channels:")
    for name, sensor in rig.channels.items():
        _write_channel(sheet, rig, name, sensor)
    if rig.annotations:
        sheet.field(2, "annotations:")
        sheet.field(3, f"- topic: {yaml_scalar(rig.annotations[0])}", "guess: boxes by its type and name")
        for other in rig.annotations[1:]:
            sheet.off(3, f"- topic: {yaml_scalar(other)}")
    for frame, channels in _shared_frames(rig):
        sheet.note(
            2,
            f"not guessed: {', '.join(channels)} all name the frame {frame}, so they get one pose; give each its own "
            "`frame` or `extrinsics`.",
        )
    for topic, why in rig.left_out:
        sheet.note(2, f"left out: {topic} ({why})")
    sheet.blank()


def _write_pose(sheet: Sheet, rig: RigProposal) -> None:
    sheet.field(2, "ego_pose:")
    if not rig.pose.fields:
        sheet.note(
            3, "not guessed: the recordings hold no odometry, pose, TF chain or GNSS fixes. Name where poses"
        )
        sheet.note(3, "come from; if this rig stands still, uncomment the next line:")
        sheet.off(3, "source: fixed")
        return
    for field, value in rig.pose.fields.items():
        reason = rig.pose.reasons.get(field, "")
        sheet.field(3, f"{field}: {yaml_scalar(value)}", f"guess: {reason}" if reason else "")
    for note in rig.pose.notes:
        sheet.note(3, note if note.startswith("not guessed") else f"guess: {note}")


def _write_channel(sheet: Sheet, rig: RigProposal, name: str, sensor: Sensor) -> None:
    topic = sensor.topic
    sheet.field(3, f"{name}:", f"guess: {rig.reasons[name]}")
    sheet.field(4, f"modality: {sensor.modality}")
    sheet.field(4, f"topic: {yaml_scalar(topic.name)}")
    if sensor.modality == "camera":
        _write_camera(sheet, sensor)
    if sensor.modality == "lidar" and topic.timed is False:
        sheet.note(
            4,
            "guess: stamps stay as recorded, as the points have no times. Some drivers stamp the start of a revolution, "
            "others its end or middle, simulators the one instant of all points; docs/poses.md tells how to find "
            "out, and a check does. If the header's stamp marks the start of a revolution, uncomment the next line; write "
            "middle or end instead of start if it marks that.",
        )
        sheet.off(4, "header_stamp_is: start")
    if not topic.frames:
        sheet.note(4, "not guessed: the headers name no frame; give the sensor's")
        sheet.off(4, f"frame: {yaml_scalar(rig.ego.name)}")
    elif len(topic.frames) > 1:
        sheet.note(
            4,
            f"not guessed: headers name several frames ({', '.join(topic.frames[:4])}); `frame` chooses one",
        )
    frame = topic.frames[0] if topic.frames else ""
    if not frame or not connected(rig.glance.edges, rig.ego.name, frame):
        sheet.note(
            4,
            f"not guessed: no transform from {rig.ego.name} to {frame or 'the sensor'} was seen; give a `urdf` of the "
            "rig, or measure (ego <- sensor, metres; quaternion w, x, y, z):",
        )
        sheet.off(4, "extrinsics: {translation: [0, 0, 0], rotation: [1, 0, 0, 0]}")


def _shared_frames(rig: RigProposal) -> list[tuple[str, list[str]]]:
    """Return frames that several cameras claim to be in, with the channels."""
    channels: dict[str, list[str]] = {}
    for name, sensor in rig.channels.items():
        if sensor.modality == "camera":
            for frame in sensor.topic.frames[:1]:
                channels.setdefault(frame, []).append(name)
    return [(frame, names) for frame, names in channels.items() if len(names) > 1]


def _write_camera(sheet: Sheet, sensor: Sensor) -> None:
    info = sensor.camera_info
    undistort = info is not None and info.calibrated is True
    if info is not None:
        sheet.field(4, f"camera_info: {yaml_scalar(info.name)}")
    if not undistort:
        why = "no CameraInfo topic" if info is None else "its CameraInfo is not calibrated"
        sheet.field(4, "undistort: false", f"guess: {why}; `intrinsics` gives a calibration by hand")
    if sensor.topic.msgtype.endswith("CompressedImage") and not undistort:
        sheet.field(4, "output: as_recorded", "guess: already compressed; passed through byte for byte")
    elif sensor.topic.is_16_bit:
        sheet.field(
            4,
            "to_8bit: {percentiles: [1, 99]}",
            f"guess: {(sensor.topic.encoding or '').replace('uc', 'UC')} must become 8 bit for JPEG; `output: png` keeps 16 bit",
        )


def _annotations(glance: Glance) -> list[str]:
    """Return topics with boxes: those that look like truth first, then by number of messages."""
    topics = [
        topic
        for topic in glance.topics.values()
        if topic.count > 0
        and topic.problem is None
        and topic.msgtype in types_of("boxes")
        and (not topic.msgtype.startswith(_MARKERS) or _TRUTH & set(tokens(topic.name)))
    ]
    topics.sort(key=lambda topic: (not _TRUTH & set(tokens(topic.name)), -topic.count, topic.name))
    return [topic.name for topic in topics]


def _rig_name(match: list[str], taken: Collection[str]) -> str:
    if match == ["**"]:
        name = "rig"
    else:
        stem = match[0].removesuffix("/**").rsplit("/", 1)[-1]
        stem = re.sub(r"\.(bag|mcap|db3)$", "", stem)
        name = re.sub(r"[^A-Za-z0-9_.-]+", "-", stem).strip("-._") or "rig"
    if name not in taken:
        return name
    return next(f"{name}-{n}" for n in range(2, len(taken) + 3) if f"{name}-{n}" not in taken)
