"""The step `calibration`: where each sensor sits on the vehicle, and how its camera projects.

Extrinsics come from the recipe, else from `/tf_static`, the URDF and the fixed joints of
`/tf`, in this order of trust (see `bagassets.steps.rig_frames`). Sources that contradict each
other are noted; the most trusted one is used.
"""

from collections.abc import Mapping
from typing import Any

from bagassets.bags.inventory import Inventory
from bagassets.bags.model import Recording
from bagassets.errors import CalibrationError
from bagassets.geometry.se3 import SE3
from bagassets.geometry.urdf import urdf_edges
from bagassets.recipe.model import CameraChannel, Rig
from bagassets.steps.channel import Request
from bagassets.steps.intrinsics import camera_info_topic, camera_intrinsics, is_rectified, rounded
from bagassets.steps.rig_frames import RigFrames
from bagassets.store.action import Step
from bagassets.store.artifact import ArtifactWriter
from bagassets.store.canonical import digest_bytes

__all__ = ["STEP", "camera_info_topic", "make", "request"]

STEP = Step("calibration", 3)


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
            fields["rectified"] = is_rectified(channel)
            fields["camera_info"] = own = camera_info_topic(channel)
            # If this is the second camera of a stereo pair, the first one may be among these.
            fields["same_frame"] = [] if channel.extrinsics else _infos_of(inventory, fields["frame"], own)
            topics += [topic for topic in (own, *fields["same_frame"]) if inventory.has(topic)]
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


def _infos_of(inventory: Inventory, frame: str, but: str) -> list[str]:
    """Return the CameraInfo topics of a frame, except one of them."""
    infos = inventory.of_type("sensor_msgs/msg/CameraInfo")
    return [info.name for info in infos if info.name != but and frame and frame in info.frame_ids]


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
        camera = None
        if fields["modality"] == "camera":
            camera, frame_SE3_image = camera_intrinsics(name, fields, recording, notes)
            ego_SE3_sensor = ego_SE3_sensor @ frame_SE3_image
        sources[source] = sources.get(source, 0) + 1
        channels[name] = {
            "frame": fields["frame"],
            "ego_SE3_sensor": {
                "translation": [rounded(v) for v in ego_SE3_sensor.translation],
                "rotation": [rounded(v) for v in ego_SE3_sensor.rotation],
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
            f"{name} ({fields['topic']}): {err}. {_damage(frames)}Correct ego_frame or the channel's frame in the "
            "recipe, or give its extrinsics there."
        ) from err
    notes += [f"{name}: {note}." for note in frames.disagreements(ego_frame, frame)]
    return ego_SE3_sensor, "+".join(sources)


def _damage(frames: RigFrames) -> str:
    """Return what of the transforms could not be decoded, as that may be what is missing; else nothing."""
    topics = [f"{topic} ({reason})" for topic, reason in sorted(frames.troubles.items())]
    return (
        f"Transforms could not be decoded in {', '.join(topics)}, so frames may be missing. "
        if topics
        else ""
    )
