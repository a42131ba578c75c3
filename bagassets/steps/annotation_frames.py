"""The frames of boxes: the part of the step `annotations` that decides which transforms it reads."""

from collections.abc import Collection, Mapping
from typing import Any

from bagassets.annotations.frames import DATASET_FRAME, BoxFrames
from bagassets.bags.inventory import Inventory
from bagassets.bags.model import Recording
from bagassets.geometry.se3 import SE3
from bagassets.geometry.tf_tree import TfTree
from bagassets.geometry.trajectory import Trajectory
from bagassets.recipe.model import Rig
from bagassets.steps.transform_logs import read_transforms
from bagassets.store.artifact import Artifact

__all__ = ["box_frames", "frame_params"]

# The inventory keeps the first few frames of a topic only.
_MOST_FRAMES = 5


def frame_params(
    rig: Rig,
    inventory: Inventory,
    calibration: Mapping[str, Any],
    ego_poses: Artifact,
    *,
    topics: Mapping[str, str | None],
    files: Collection[str | None],
) -> dict[str, Any]:
    """Return what places boxes; `tf` and `tf_static` name the topics of transforms to read.

    Transforms are read only if boxes are, or may be, in a frame that poses and calibration do
    not know: `/tf` changes with every pose.

    Args:
        rig: the rig that made the recording.
        inventory: what is in the recording.
        calibration: content of `calibration.json`.
        ego_poses: the artifact of poses.
        topics: topic of boxes -> the frame that the recipe says they are in, if it does.
        files: of each source of files, the frame that the recipe says or the format means; None if each box says.
    """
    poses = ego_poses.read_json("ego_poses.json")
    extrinsics = {entry["frame"]: entry["ego_SE3_sensor"] for entry in calibration["channels"].values()}
    known = {poses["global_frame"], DATASET_FRAME, rig.ego_frame, *extrinsics}
    frames: list[str | None] = list(files)
    for topic, frame in topics.items():
        recorded = inventory.topic(topic).frame_ids if frame is None else (frame,)
        # Items of a message may have frames of their own.
        frames += recorded if recorded and len(recorded) < _MOST_FRAMES else [None]
    needed = any(frame not in known for frame in frames)
    return {
        "global_frame": poses["global_frame"],
        "origin_m": _origin_m(poses["origin"]),
        "ego_frame": rig.ego_frame,
        "ego_SE3_frame": extrinsics,
        "tf_static": [topic for topic in rig.tf_static if needed and inventory.has(topic)],
        "tf": [topic for topic in rig.tf if needed and inventory.has(topic)],
    }


def box_frames(params: Mapping[str, Any], recording: Recording, trajectory: Trajectory) -> BoxFrames:
    """Return the frames of the parameters made by `frame_params`, with the transforms read."""
    extrinsics = {
        frame: SE3.create(transform["rotation"], transform["translation"])
        for frame, transform in params.get("ego_SE3_frame", {}).items()
    }
    x, y, z = params.get("origin_m", (0.0, 0.0, 0.0))
    tree = None
    if params.get("tf_static") or params.get("tf"):
        clock = params["clock"]
        layers = [read_transforms(recording, params[name], name, clock=clock) for name in ("tf_static", "tf")]
        tree = TfTree(*layers)
    return BoxFrames(
        params.get("global_frame", ""), params.get("ego_frame", ""), extrinsics, trajectory, (x, y, z), tree
    )


def _origin_m(origin: Mapping[str, Any] | None) -> list[float]:
    """Return what `ego_poses` subtracted from the coordinates recorded in the global frame."""
    if origin is None or origin["kind"] != "local":
        return [0.0, 0.0, 0.0]
    return [origin["x"], origin["y"], origin["z"]]
