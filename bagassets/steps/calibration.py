"""The step `calibration`: where each sensor sits on the vehicle, and how its camera projects.

Extrinsics come from the recipe, else from `/tf_static`, the URDF and the fixed joints of
`/tf`, in this order of trust (see `bagassets.steps.rig_frames`). Sources that contradict each
other are noted; the most trusted one is used.
"""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from bagassets.bags.inventory import Inventory
from bagassets.bags.model import Recording
from bagassets.decode.camera_info import CameraInfoReading, check_lens, decode_camera_info
from bagassets.errors import CalibrationError, DecodeError
from bagassets.geometry.se3 import SE3
from bagassets.geometry.urdf import urdf_edges
from bagassets.recipe.model import CameraChannel, Rig
from bagassets.steps.channel import Counts, Request
from bagassets.steps.rig_frames import RigFrames
from bagassets.store.action import Step
from bagassets.store.artifact import ArtifactWriter
from bagassets.store.canonical import digest_bytes

__all__ = ["STEP", "camera_info_topic", "make", "request"]

STEP = Step("calibration", 2)


def camera_info_topic(channel: CameraChannel) -> str:
    """Return the CameraInfo topic: the recipe's, else `camera_info` beside the image topic."""
    if channel.camera_info is not None:
        return channel.camera_info
    parts = channel.topic.split("/")
    if parts[-1] == "compressed" and len(parts) > 2:
        parts = parts[:-1]
    return "/".join([*parts[:-1], "camera_info"])


def request(rig: Rig, inventory: Inventory) -> Request:
    """Return what the step reads of this recording.

    Raises:
        CalibrationError: the URDF cannot be read, or a topic carries messages of several frames.
    """
    channels: dict[str, Any] = {}
    topics: list[str] = []
    for name, channel in sorted(rig.channels.items()):
        if not inventory.has(channel.topic):
            continue
        frames = inventory.topic(channel.topic).frame_ids
        fields = channel.model_dump(mode="json", include={"extrinsics", "intrinsics", "undistort"})
        if channel.frame is None and channel.extrinsics is None and len(frames) > 1:
            raise CalibrationError(
                f"{name}: the messages of {channel.topic} are in several frames ({', '.join(frames)}), a channel is "
                "one sensor; name the one to use in `frame`, or give `extrinsics` in the recipe."
            )
        fields |= {"topic": channel.topic, "frame": channel.frame or (frames[0] if frames else "")}
        if isinstance(channel, CameraChannel) and channel.intrinsics is None:
            fields["camera_info"] = camera_info_topic(channel)
            topics += [fields["camera_info"]] if inventory.has(fields["camera_info"]) else []
        channels[name] = fields | {"modality": channel.modality}
    by_recipe = all(fields["extrinsics"] is not None for fields in channels.values())
    static = [topic for topic in rig.tf_static if inventory.has(topic) and not by_recipe]
    moving = [topic for topic in rig.tf if inventory.has(topic) and not by_recipe]
    params = {"ego_frame": rig.ego_frame, "channels": channels, "tf_static": static, "tf": moving}
    inputs = {}
    if rig.urdf is not None and not by_recipe:
        try:
            inputs["urdf"] = digest_bytes(rig.urdf.read_bytes())
        except OSError as err:
            raise CalibrationError(f"{rig.urdf}: the URDF cannot be read ({err.strerror}).") from err
    return Request(params, tuple(sorted({*topics, *static, *moving})), inputs)


def make(
    params: Mapping[str, Any], recording: Recording, out: ArtifactWriter, *, urdf: bytes | None
) -> dict[str, Any]:
    """Write `calibration.json` and return the summary.

    Raises:
        CalibrationError: extrinsics or intrinsics that a channel needs are missing or implausible.
    """
    joints = [] if urdf is None else urdf_edges(urdf)
    frames = RigFrames(recording, params["tf_static"], params["tf"], joints)
    notes: list[str] = []
    channels = {}
    sources: dict[str, int] = {}
    for name, fields in params["channels"].items():
        ego_SE3_sensor, source = _extrinsics(name, fields, params["ego_frame"], frames, notes)
        camera = _camera(name, fields, recording, notes) if fields["modality"] == "camera" else None
        sources[source] = sources.get(source, 0) + 1
        channels[name] = {
            "frame": fields["frame"],
            "ego_SE3_sensor": {
                "translation": [_rounded(v) for v in ego_SE3_sensor.translation],
                "rotation": [_rounded(v) for v in ego_SE3_sensor.rotation],
            },
            "source": source,
            "camera": camera,
        }
    out.write_json(
        "calibration.json", {"ego_frame": params["ego_frame"], "channels": channels, "notes": notes}
    )
    cameras = sum(channel["camera"] is not None for channel in channels.values())
    return {
        "sensors": len(channels),
        "cameras": cameras,
        "sources": sources,
        "transforms": frames.counts.as_json(),
        "notes": notes,
    }


def _extrinsics(
    name: str, fields: Mapping[str, Any], ego_frame: str, frames: RigFrames, notes: list[str]
) -> tuple[SE3, str]:
    given = fields["extrinsics"]
    if given is not None:
        return SE3.create(given["rotation"], given["translation"]), "recipe"
    frame = fields["frame"]
    if not frame:
        raise CalibrationError(
            f"{name}: the messages of {fields['topic']} name no frame; give `frame` or `extrinsics` in the recipe."
        )
    if frame == ego_frame:
        return SE3(), "ego frame"
    try:
        ego_SE3_sensor, sources = frames.fixed(ego_frame, frame)
    except CalibrationError as err:
        raise CalibrationError(
            f"{name} ({fields['topic']}): {err}. Correct ego_frame or the channel's frame in the recipe, "
            "or give its extrinsics there."
        ) from err
    notes += [f"{name}: {note}." for note in frames.disagreements(ego_frame, frame)]
    return ego_SE3_sensor, "+".join(sources)


def _camera(
    name: str, fields: Mapping[str, Any], recording: Recording, notes: list[str]
) -> dict[str, Any] | None:
    given = fields["intrinsics"]
    if given is not None:
        return _by_hand(name, given)
    topic = fields["camera_info"]
    if topic not in recording.topics:
        if not fields["undistort"]:
            return None
        raise CalibrationError(
            f"{name} ({fields['topic']}): no CameraInfo on {topic}, which undistortion needs; name the topic in "
            "`camera_info`, give `intrinsics`, or set `undistort: false` in the recipe."
        )
    reading, lost = _one_calibration(name, topic, recording)
    if reading is None:
        if fields["undistort"]:
            raise CalibrationError(
                f"{name}: no usable CameraInfo on {topic}{_reasons(lost)}; give `intrinsics` or set `undistort: false`."
            )
        return None
    if lost:
        notes.append(f"{name}: {sum(lost.values())} messages on {topic} cannot be used{_reasons(lost)}.")
    calibration = reading.calibration
    return {
        "model": calibration.model,
        "width": calibration.width,
        "height": calibration.height,
        "k": [_rounded(v) for v in calibration.k],
        "d": [_rounded(v) for v in calibration.d],
        "r": [_rounded(v) for v in calibration.r],
        "p": [_rounded(v) for v in calibration.p],
        "binning": list(calibration.binning),
        "roi": asdict(calibration.roi),
        "source": "camera_info",
    }


def _one_calibration(
    name: str, topic: str, recording: Recording
) -> tuple[CameraInfoReading | None, dict[str, int]]:
    """Return the calibration that all messages of `topic` agree on, and why others cannot be used."""
    first: CameraInfoReading | None = None
    counts = Counts()
    for message in recording.messages([topic]):
        try:
            reading = decode_camera_info(recording.decode(message))
        except DecodeError as err:
            counts.lose(str(err))
            continue
        if first is None:
            first = reading
        elif reading.calibration.lens != first.calibration.lens:
            raise CalibrationError(
                f"{name}: the calibration on {topic} changes at {reading.stamp_ns / 1e9:.3f} s; one recording has "
                "one calibration. Split the recording there, or give `intrinsics` in the recipe."
            )
    return first, counts.lost


def _reasons(lost: Mapping[str, int]) -> str:
    return ": " + "; ".join(lost) if lost else ""


def _by_hand(name: str, given: Mapping[str, Any]) -> dict[str, Any]:
    k = [given["fx"], 0.0, given["cx"], 0.0, given["fy"], given["cy"], 0.0, 0.0, 1.0]
    d = list(given["distortion"])
    model = given["model"]
    if not d:  # an equidistant lens is none by its coefficients alone
        model, d = ("equidistant", [0.0] * 4) if model == "equidistant" else ("none", [])
    width, height = given["width"], given["height"]
    try:
        check_lens(model, width, height, k, d)
    except DecodeError as err:
        raise CalibrationError(f"{name}: intrinsics in the recipe: {err}.") from err
    return {
        "model": model,
        "width": width,
        "height": height,
        "k": k,
        "d": d,
        "r": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        "p": [*k[:3], 0.0, *k[3:6], 0.0, *k[6:], 0.0],
        "binning": [1, 1],
        "roi": {"x_offset": 0, "y_offset": 0, "width": width, "height": height, "do_rectify": False},
        "source": "recipe",
    }


def _rounded(value: float) -> float:
    """Round to 12 significant digits, which hides the last bits of compositions."""
    return float(f"{value:.12g}") + 0.0
