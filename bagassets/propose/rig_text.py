"""A proposed rig as YAML, with the reason of each value and a question where only the user knows."""

from collections.abc import Sequence
from math import ceil

from bagassets.base.escaping import yaml_scalar
from bagassets.decode.registry import families_of
from bagassets.propose.calibration_files import FoundCalibration, ProposedCalibration, calibration_of
from bagassets.propose.commented_yaml import Sheet
from bagassets.propose.frames import MOUNT, connected, contradiction, is_optical, mounting
from bagassets.propose.naming import PREFIX, tokens
from bagassets.propose.poses import lonely_poses
from bagassets.propose.rigs import RigProposal
from bagassets.propose.sensors import Sensor, has_ouster_packets, metadata_of, needs_metadata, shown_type
from bagassets.propose.signals import write_signals
from bagassets.propose.summary import TopicSummary, transform_topics
from bagassets.recipe.model import Rig
from bagassets.recordings.globs import literal_glob

_LEAST_POSES_HZ = 3.0  # slower ones, such as GNSS fixes, can be farther apart than max_gap_s is by default
_USUAL_TF = (*Rig.model_fields["tf"].default, *Rig.model_fields["tf_static"].default)


def write_rig(
    sheet: Sheet, rig: RigProposal, calibrations: Sequence[FoundCalibration] = (), *, clock: bool
) -> None:
    """Write a rig below `rigs:`.

    Args:
        sheet: what is written to.
        rig: the rig.
        calibrations: calibration files that lie near the recordings.
        clock: write its clock, which is not that of the recipe.
    """
    sheet.rig, number = rig.name, len(rig.recordings)
    sheet.field(1, f"- name: {yaml_scalar(rig.name)}", f"{number} recording{'s' if number != 1 else ''}")
    _write_match(sheet, rig)
    if not rig.is_arm:
        reason = rig.ego.reason or "the usual name; the recordings suggest no other"
        sheet.guess(2, f"ego_frame: {yaml_scalar(rig.ego.name)}", reason)
    if clock:
        sheet.guess(2, f"clock: {rig.clock.clock}", rig.clock.reason or "its header stamps can be used")
    if not rig.is_arm:
        _write_placement(sheet, rig)
    if rig.channels:
        sheet.field(2, "channels:")
    for name, sensor in rig.channels.items():
        _write_channel(sheet, rig, name, sensor, calibrations)
    write_signals(sheet, rig.signals)
    if rig.annotations and not rig.is_arm:
        sheet.field(2, "annotations:")
        sheet.guess(3, f"- topic: {yaml_scalar(rig.annotations[0])}", "boxes by its type and name")
        if frames := _unknown_frames(rig, rig.annotations[0]):
            are = f"its boxes are in {', '.join(frames)}, to which neither the poses nor TF lead"
            give = "say in `frame` which known frame that is, choose poses in it, or remove this topic"
            sheet.ask(4, rig.annotations[0], f"{are}; {give}")
        for other in rig.annotations[1:]:
            sheet.off(3, f"- topic: {yaml_scalar(other)}")
    for frame, channels in [] if rig.is_arm else _shared_frames(rig):
        sheet.guess_note(
            2,
            f"{', '.join(channels)} all name the frame {frame}, so they get one pose; give each its own `frame` or "
            "`extrinsics` if they are not at one place.",
        )
    for left in rig.left_out:
        sheet.note(2, f"left out: {left.topic.name} ({left.text})")
    for robot in list(rig.summary.robots)[1:]:
        sheet.note(2, f"left out: all below {robot} (another robot)")
    sheet.blank()
    sheet.rig = ""


def _unknown_frames(rig: RigProposal, boxes: str) -> list[str]:
    """Return the frames of a topic with boxes that builds will not know."""
    pose, topics = rig.pose.fields, rig.summary.topics
    known = {rig.ego.name, pose.get("global_frame", "enu")}
    for topic in (*(sensor.topic for sensor in rig.channels.values()), topics.get(pose.get("topic", ""))):
        known.update(topic.frames if topic is not None else ())
    edges = rig.summary.edges
    return [one for one in topics[boxes].frames if not any(connected(edges, place, one) for place in known)]


def _write_placement(sheet: Sheet, rig: RigProposal) -> None:
    """Write how the frames of the rig hang together, and where it is."""
    _write_transforms(sheet, rig)
    if rig.urdf is not None:
        line = f"urdf: {yaml_scalar(urdf_name(rig))}"
        if rig.urdf.status == "used":
            sheet.guess(2, line, f"{rig.urdf.topic.name}, for frames that TF does not connect")
        else:
            sheet.note(
                2,
                f"recorded on {rig.urdf.topic.name}; it places no sensor unless channels name a `frame` of it:",
            )
            sheet.off(2, line)
    _write_pose(sheet, rig)


def urdf_name(rig: RigProposal) -> str:
    """Return the name of the file beside the recipe that holds the URDF of a rig."""
    return f"{rig.name}.urdf"


def _write_match(sheet: Sheet, rig: RigProposal) -> None:
    if rig.match == ["**"]:
        return
    if len(rig.match) == 1:
        sheet.field(2, f"match: [{yaml_scalar(rig.match[0])}]")
    else:
        if rig.match == [literal_glob(path) for path in sorted(rig.recordings)]:
            sheet.guess_note(
                2, "these recordings by their names; new ones of this rig need a glob that matches them"
            )
        sheet.field(2, "match:")
        for glob in rig.match:
            sheet.field(3, f"- {yaml_scalar(glob)}")


def _write_transforms(sheet: Sheet, rig: RigProposal) -> None:
    topics = transform_topics(rig.summary)
    if set(topics) <= set(_USUAL_TF):
        return
    static = [name for name in topics if "static" in name]
    for field, names in (("tf", [name for name in topics if name not in static]), ("tf_static", static)):
        if names:
            sheet.field(2, f"{field}: [{', '.join(map(yaml_scalar, names))}]")


def _write_pose(sheet: Sheet, rig: RigProposal) -> None:
    sheet.field(2, "ego_pose:")
    if not rig.pose.fields:
        but = "".join(f" but one of {name}" for name in lonely_poses(rig.summary)[:1])
        for name, one in rig.summary.topics.items():
            if one.count and one.msgtype.endswith("Odometry") and not families_of(one.msgtype):
                but = f" but {name}, whose {shown_type(one.msgtype)} needs a decoder (`bagassets docs page decoders`)"
        sheet.ask(
            3,
            "ego_pose",
            f"the recordings hold no odometry, pose, TF chain or GNSS fixes{but}; name where "
            "poses come from, or if this rig stands still, uncomment `source: fixed`",
            below=True,
        )
        sheet.off(3, "source: fixed")
        return
    robots = [
        name or "the one without namespace" for name, has_sensors in rig.summary.robots.items() if has_sensors
    ]
    if len(robots) > 1:
        sheet.ask(
            3,
            "ego_pose",
            f"whose dataset it is: {len(robots)} robots were recorded together ({', '.join(robots)}), and a recording has one "
            f"rig. This one has the topics of {robots[0]}; uncomment its poses to keep it. For another robot put its topics in "
            "their place, in a project of its own",
            ":",
            below=True,
        )
    lines = {
        f"{field}: {yaml_scalar(value)}": rig.pose.reasons.get(field, "")
        for field, value in rig.pose.fields.items()
    }
    topic = rig.summary.topics.get(rig.pose.fields.get("topic", ""))
    if topic is not None and topic.rate_hz and topic.rate_hz < _LEAST_POSES_HZ:
        line = f"max_gap_s: {ceil(15 / topic.rate_hz) / 10:g}"
        lines[line] = f"poses come every {1 / topic.rate_hz:.3g} s; readings in longer gaps have none"
    for line, reason in lines.items():
        if len(robots) > 1:
            sheet.off(3, line)
        else:
            sheet.guess(3, line, reason)
    for frame in topic.frames if topic is not None else ():
        if "ned" in tokens(frame):
            sheet.guess_note(
                3, f"{frame} sounds as if z were down; datasets expect it up, and nothing turns it"
            )
    for note in rig.pose.notes:
        sheet.guess_note(3, note)
    if rig.pose.gap:
        sheet.ask(
            3,
            "ego_pose",
            f"{rig.pose.gap}; correct ego_frame, name a `urdf` of the rig, or the frame whose pose it is in `frame`",
        )


def _write_channel(
    sheet: Sheet, rig: RigProposal, name: str, sensor: Sensor, calibrations: Sequence[FoundCalibration]
) -> None:
    topic = sensor.topic
    file: ProposedCalibration | None = None
    sheet.guess(3, f"{name}:", rig.reasons[name])
    sheet.field(4, f"modality: {sensor.modality}")
    sheet.field(4, f"topic: {yaml_scalar(topic.name)}")
    if topic.unstamped and rig.clock.clock == "header":
        lack = "its header stamps are zero"
        if has_ouster_packets(topic):
            lack = "its packets have no stamps; `header` takes the times of the lidar, if PTP keeps them near the host's"
        sheet.guess(4, "clock: log", lack)
    elif topic.name in rig.clock.odd:
        sheet.guess(4, "clock: log", "its header stamps are of another clock")
    if needs_metadata(topic) and metadata_of(topic, rig.summary) is None:
        sheet.field(4, "metadata:")
        wanted = (
            "name the correction file of this Hesai, the CSV with the angles of its channels, which its packets do not say"
            if topic.packets_of
            else "the recording has no topic `metadata` beside the packets; record it, too, and remove this field, or name a file "
            "with the lidar's metadata"
        )
        sheet.ask(5, name, wanted, below=True)
    if sensor.modality == "camera":
        # What was recorded is of this camera for sure, so a file only stands in for it.
        file = None if _has_lens(sensor) else calibration_of(topic.name, calibrations)
        _write_camera(sheet, sensor, file)
    elif sensor.modality == "lidar":
        _write_lidar(sheet, name, topic, has_poses=bool(rig.pose.fields))
    known = sorted(topic.velocities - {"undecided"})
    if len(known) == 1:
        sheet.guess(4, f"velocities: {known[0]}", "by what stands still while the vehicle drives")
    elif topic.velocities and rig.pose.fields:
        sheet.field(4, "velocities:")
        text = "the recordings do not show whether velocities are relative to the radar, so that they must be compensated for its "
        text += "motion, or over_ground; write which, or remove the field to keep them as recorded"
        sheet.ask(5, name, text, below=True)
    if not rig.is_arm:
        _write_place(sheet, rig, name, sensor, file)


def _write_lidar(sheet: Sheet, name: str, topic: TopicSummary, *, has_poses: bool) -> None:
    clock = topic.clock
    if clock is not None and clock.doubt:
        what = f"it is not sure what the times of its points are: {clock.doubt}; say it in `point_times`, or `ignore`"
        sheet.ask(4, name, what)
        since = "header" if clock.origin == "header" else "clock"
        sheet.off(4, f"point_times: {{unit: {clock.unit}, since: {since}}}")
    if topic.most_intensity is not None and topic.most_intensity <= 1.0:
        sheet.guess(4, "intensity_scale: 255", "its intensities are 0 to 1; those of nuScenes are 0 to 255")
    if topic.timed is False or (clock is not None and clock.origin != "header" and not clock.is_of_headers):
        if clock is None:
            lack = "no times"
        elif clock.problem:
            lack = f"times that cannot be used, as {clock.problem}"
        else:
            lack = "times of another clock, which do not say what these mark"
        sheet.guess_note(
            4,
            f"stamps stay as recorded, as the points have {lack}. Some drivers stamp the start of a revolution, "
            "others its end or middle, simulators the one instant of all points; `bagassets docs page poses` says how to find "
            "out, and a check does. If the header's stamp marks the start of a revolution, uncomment the next line; write "
            "middle or end instead of start if it marks that.",
        )
        sheet.off(4, "header_stamp_is: start")
    elif topic.timed and has_poses:
        sheet.note(4, "uncomment to move each point to where it would be seen at the stamp of its sweep:")
        sheet.off(4, "deskew: true")


def _write_place(
    sheet: Sheet, rig: RigProposal, name: str, sensor: Sensor, file: ProposedCalibration | None
) -> None:
    """Write where a sensor sits, if TF does not tell."""
    frames = sensor.topic.frames
    if not frames and sensor.camera_info is not None and sensor.camera_info.frames:
        frames = sensor.camera_info.frames[:1]
        sheet.guess(4, f"frame: {yaml_scalar(frames[0])}", "of its CameraInfo, as its own headers name none")
    if has_ouster_packets(sensor.topic):
        frames = _frame_of_ouster(rig, sensor.topic.name)
        if frames:
            sheet.guess(4, f"frame: {yaml_scalar(frames[0])}", "of Ouster's driver, as packets name none")
    frame = frames[0] if frames else ""
    optical = sensor.modality == "camera" or is_optical(rig.summary, frame) is True
    side = _side(rig, name)
    is_turned = has_ouster_packets(sensor.topic)  # x of os_lidar points to its plug
    rotation = list(mounting("camera" if optical else sensor.modality, "BACK" if is_turned else side))
    if len(frames) > 1:
        sheet.ask(
            4,
            name,
            f"its messages are in several frames ({', '.join(frames[:4])}); choose one in `frame`",
        )
        sheet.off(4, f"frame: {yaml_scalar(frame)}")
    if rig.ego.is_sensor and frame and (optical or frame != rig.ego.name):
        sheet.guess(
            4,
            f"extrinsics: {{translation: [0, 0, 0], rotation: {_numbers(rotation)}}}",
            "the ego frame is where this sensor is, x ahead and z up; measured ones are better",
        )
    elif lack := _lack(rig, frame):
        give = "measure `extrinsics`"
        if sensor.modality == "camera":
            give = "give `extrinsics`, measured or from a file of Kalibr"
        if rig.signals:
            give += "; if only LeRobot's dataset is wanted, remove `nuscenes` and this field"
        looks = f"looks {side.replace('_', ' ').lower()}" if side else "looks ahead"
        looks = "has its plug at the back, where x of os_lidar points to" if is_turned else looks
        if not frame and not optical:  # which turns a camera's axes
            sheet.off(4, f"frame: {yaml_scalar(rig.ego.name)}")
        sheet.field(4, "extrinsics:")
        sheet.ask(
            5,
            name,
            f"{lack}, or {give}",
            f" (ego <- sensor, metres; quaternion w, x, y, z; this one {looks}):",
            below=True,
        )
        sheet.off(5, "translation: [0, 0, 0]")
        sheet.off(5, f"rotation: {_numbers(rotation)}")
        if file is not None and file.relative_to:
            sheet.note(
                5,
                f"or from the calibration file, relative to {file.relative_to}, whose frame TF or a `urdf` must have:",
            )
            sheet.off(5, f"file: {yaml_scalar(file.written)}")
            sheet.off(5, "relative_to: frame")


def _frame_of_ouster(rig: RigProposal, topic: str) -> tuple[str, ...]:
    """Return the frame in TF whose words are most like those of a topic; none if another frame or topic is as likely."""
    frames = {frame for edge in rig.summary.edges for frame in edge if "os_lidar" in frame}
    rivals = {one.topic.name for one in rig.channels.values() if has_ouster_packets(one.topic)} - {topic}

    def alike(one: str, frame: str) -> tuple[int, int]:
        words = set(tokens(frame))
        return len(words & set(tokens(one))), -len(words)

    return tuple(
        frame
        for frame in frames
        if all(alike(topic, frame) > alike(topic, other) for other in frames - {frame})
        and all(alike(topic, frame) > alike(one, frame) for one in rivals)
    )


def _lack(rig: RigProposal, frame: str) -> str:
    """Return why it is not known where a sensor sits, and what to do; "" if it is."""
    if not frame:
        return "its headers name no frame; give `frame`; name a `urdf` of the rig"
    if not connected(rig.summary.edges, rig.ego.name, frame):
        if rig.urdf is not None and all(f'"{one}"' in rig.urdf.topic.urdf for one in (rig.ego.name, frame)):
            return f"in the URDF, joints that move lead from {rig.ego.name} to {frame}{MOUNT}"
        return f"no transform from {rig.ego.name} to {frame} was seen; name a `urdf` of the rig"
    trouble = contradiction(rig.summary, rig.ego.name, frame)
    return trouble and f"{trouble}; correct that and remove this field"


def _numbers(values: list[float]) -> str:
    return f"[{', '.join(f'{value:g}' for value in values)}]"


def _side(rig: RigProposal, name: str) -> str:
    """Return where a sensor looks by the name of its channel; the two of a stereo pair look ahead."""
    sensor = rig.channels[name]
    prefix = f"{PREFIX[sensor.modality]}_"
    sides = [
        other.removeprefix(prefix) for other, one in rig.channels.items() if one.modality == sensor.modality
    ]
    own = name.removeprefix(prefix)
    is_stereo = sensor.modality == "camera" and set(sides) <= {"LEFT", "RIGHT"}
    is_known = set(own.split("_")) <= {"FRONT", "BACK", "LEFT", "RIGHT"} and own != "FRONT"
    return own if is_known and not is_stereo else ""


def _shared_frames(rig: RigProposal) -> list[tuple[str, list[str]]]:
    """Return frames that several cameras claim to be in, with the channels, as far as TF knows the frame."""
    channels: dict[str, list[str]] = {}
    for name, sensor in rig.channels.items():
        if sensor.modality == "camera":
            for frame in sensor.topic.frames[:1]:
                if connected(rig.summary.edges, rig.ego.name, frame):
                    channels.setdefault(frame, []).append(name)
    return [(frame, names) for frame, names in channels.items() if len(names) > 1]


def _has_lens(sensor: Sensor) -> bool:
    """Return whether a camera's intrinsics were recorded."""
    return sensor.camera_info is not None and sensor.camera_info.calibrated is True


def _write_camera(sheet: Sheet, sensor: Sensor, file: ProposedCalibration | None) -> None:
    info = sensor.camera_info
    undistort = _has_lens(sensor) or file is not None
    if info is not None:
        sheet.field(4, f"camera_info: {yaml_scalar(info.name)}")
    why = "no CameraInfo topic" if info is None else "its CameraInfo is not calibrated"
    if info is not None and info.refusal:
        why = f"its CameraInfo cannot be used: {info.refusal}"
    if file is not None:
        sheet.guess(4, f"intrinsics: {{file: {yaml_scalar(file.written)}}}", f"{why}; {file.reason}")
    elif not undistort:
        sheet.guess(
            4,
            "undistort: false",
            f"{why}; `intrinsics` takes a calibration by hand, or a file of ROS, Kalibr or OpenCV",
        )
    if sensor.topic.msgtype.endswith("CompressedImage") and not (undistort or sensor.topic.is_video):
        sheet.guess(4, "output: as_recorded", "already compressed; passed through byte for byte")
    elif sensor.topic.is_16_bit:
        encoding = (sensor.topic.encoding or "").partition(":")[0].replace("uc", "UC")
        sheet.guess(
            4,
            "to_8bit: {percentiles: [1, 99]}",
            f"{encoding} must become 8 bit for JPEG; `output: png` keeps 16 bit",
        )
