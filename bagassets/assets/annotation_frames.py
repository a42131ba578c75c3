"""The frames of boxes: the part of the asset `annotations` that decides which transforms it reads."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from bagassets.assets.asset import Facts, omitted
from bagassets.assets.boxes.frames import DATASET_FRAME, BoxFrames
from bagassets.assets.ego_poses import EGO_POSES
from bagassets.assets.topic_log import MOST_FRAMES
from bagassets.assets.transform_logs import read_transforms
from bagassets.base.json_types import JsonMapping
from bagassets.geometry.se3 import SE3
from bagassets.geometry.tf_tree import TfTree
from bagassets.geometry.trajectory import Trajectory
from bagassets.geometry.wgs84 import LocalFrame
from bagassets.recipe.model_base import Clock, Vector3
from bagassets.recordings.inventory import Inventory
from bagassets.recordings.recording import Recording


@dataclass(frozen=True)
class ReadingParams:
    """Further parameters of `annotations`, if the recipe names any boxes.

    Attributes:
        clock: which time of a message counts.
        lost_messages: share of messages and boxes that may be lost to decoding.
        ego_frame: frame of the vehicle.
        tf_static: topics with static transforms, whether or not a recording has them.
        tf: topics with transforms, whether or not a recording has them.
        channels: topics of the channels, which limit the times of labels; empty without label files.
        other_clock: those of channels for which the other time of a message counts.
    """

    clock: Clock
    lost_messages: float
    ego_frame: str
    tf_static: tuple[str, ...]
    tf: tuple[str, ...]
    channels: tuple[str, ...]
    other_clock: tuple[str, ...] = omitted(())


@dataclass(frozen=True)
class BoxPlaces:
    """Everything needed to transform a recording's boxes to the global frame.

    Attributes:
        global_frame: name of the global frame of the poses.
        origin_m: offset that `ego_poses` subtracted from recorded coordinates in it.
        ego_frame: frame of the vehicle, whose poses are known.
        ego_SE3_frame: frame of a sensor -> its mount.
        tf_static: topics with static transforms to read.
        tf: topics with transforms to read.
    """

    global_frame: str
    origin_m: Vector3
    ego_frame: str
    ego_SE3_frame: Mapping[str, SE3]
    tf_static: tuple[str, ...]
    tf: tuple[str, ...]


def box_places(facts: Facts, frames: Iterable[str | None], params: ReadingParams) -> BoxPlaces:
    """Return everything needed to transform boxes to the global frame.

    Transforms are read only if boxes are, or may be, in a frame that neither poses nor calibration
    know: `/tf` changes with every pose.

    Args:
        facts: facts about the recording.
        frames: frames of the boxes; None for one that is only known from the boxes themselves.
        params: frame of the vehicle, and topics with transforms.
    """
    poses = facts.artifact(EGO_POSES.name).read_json("ego_poses.json")
    mounts = {sensor.frame: sensor.ego_SE3_sensor for sensor in facts.calibration.channels.values()}
    known = {poses["global_frame"], DATASET_FRAME, params.ego_frame, *mounts}
    needed = any(frame not in known for frame in frames)
    static, moving = (params.tf_static, params.tf) if needed else ((), ())
    origin = poses["origin"]
    is_local = origin is not None and origin["kind"] == "local"
    return BoxPlaces(
        poses["global_frame"],
        (origin["x"], origin["y"], origin["z"]) if is_local else (0.0, 0.0, 0.0),
        params.ego_frame,
        mounts,
        tuple(filter(facts.inventory.has, static)),
        tuple(filter(facts.inventory.has, moving)),
    )


def frames_of_topic(topic: str, frame: str | None, inventory: Inventory) -> tuple[str | None, ...]:
    """Return the frames of the boxes in a topic: from the recipe, else from its messages."""
    if frame is not None:
        return (frame,)
    recorded = inventory.topic(topic).frame_ids
    # Items of a message may have frames of their own, and the inventory keeps the first few of a topic only.
    return recorded if recorded and len(recorded) < MOST_FRAMES else (None,)


def box_frames(places: BoxPlaces, clock: Clock, recording: Recording, trajectory: Trajectory) -> BoxFrames:
    """Return the frames of boxes, with the transforms read."""
    extrinsics = {frame: ego_SE3_frame.normalised() for frame, ego_SE3_frame in places.ego_SE3_frame.items()}
    tree = TfTree(
        read_transforms(recording, places.tf_static, "tf_static", clock=clock),
        read_transforms(recording, places.tf, "tf", clock=clock),
    )
    return BoxFrames(places.global_frame, places.ego_frame, extrinsics, trajectory, places.origin_m, tree)


def between_origins(here: JsonMapping | None, there: JsonMapping | None) -> SE3 | None:
    """Return `here_SE3_there` between two global frames of one robot, given the `origin` of each in `ego_poses.json`.

    None if one is on Earth and the other is not, or something else is no origin.
    """
    if here == there:
        return SE3()
    try:
        kinds = {None if origin is None else origin["kind"] for origin in (here, there)}
        if kinds <= {None, "local"}:  # offsets from the recorded frame, which is the same
            before, after = (
                [0.0 if origin is None else float(origin[axis]) for axis in "xyz"] for origin in (here, there)
            )
            return SE3.create(SE3().rotation, [b - a for a, b in zip(before, after, strict=True)])
        if here is not None and there is not None and kinds == {"wgs84"}:
            here_SE3_ecef, ecef_SE3_there = _ecef_SE3_local(here).inverse(), _ecef_SE3_local(there)
            return here_SE3_ecef @ ecef_SE3_there
    except (KeyError, TypeError, ValueError):
        pass
    return None


def _ecef_SE3_local(origin: JsonMapping) -> SE3:
    return LocalFrame(float(origin["lat"]), float(origin["lon"]), float(origin["alt"])).ecef_SE3_enu
