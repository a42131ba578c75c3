"""The sources of ego poses: each turns messages into samples of `global_SE3_ego`.

Every source returns stamps and poses in the order read, unsorted, with counts of what was
read and lost; `bagassets.steps.ego_poses` sorts, merges and writes them.
"""

from collections.abc import Callable, Mapping
from typing import Any

from bagassets.bags.model import Recording
from bagassets.decode.model import PoseReading
from bagassets.decode.odometry import decode_odometry
from bagassets.decode.pose import decode_pose
from bagassets.decode.registry import plugin_decoder
from bagassets.errors import CalibrationError, DecodeError, PoseError
from bagassets.geometry.se3 import SE3
from bagassets.geometry.tf_tree import Edge
from bagassets.plugins import installed_decoders
from bagassets.steps.pose_gnss import poses_from_navsat
from bagassets.steps.pose_ncom import poses_from_ncom
from bagassets.steps.pose_samples import PoseSamples, stamp_of
from bagassets.steps.pose_tf import poses_from_tf
from bagassets.steps.rig_frames import RigFrames

__all__ = ["PoseSamples", "read_samples"]

_DECODERS: Mapping[str, Callable[[Any], PoseReading]] = {
    "geometry_msgs/msg/PoseStamped": decode_pose,
    "geometry_msgs/msg/PoseWithCovarianceStamped": decode_pose,
    "nav_msgs/msg/Odometry": decode_odometry,
}


def read_samples(params: Mapping[str, Any], recording: Recording) -> PoseSamples:
    """Return the samples of the source that `params` name.

    Raises:
        PoseError: the source has no usable pose, or its frame cannot be related to the ego frame.
    """
    urdf = [
        Edge.fixed(parent, child, "urdf", SE3.create(rotation, translation))
        for parent, child, translation, rotation in params["urdf"]
    ]
    if params["source"] == "tf":
        return poses_from_tf(params, recording, urdf)
    frames = RigFrames(recording, params["tf_static"], params["tf"], urdf)
    match params["source"]:
        case "navsat":
            return poses_from_navsat(params, recording, frames)
        case "ncom":
            return poses_from_ncom(params, recording, frames)
        case _:
            return _from_poses(params, recording, frames)


def _from_poses(params: Mapping[str, Any], recording: Recording, frames: RigFrames) -> PoseSamples:
    decode = _pose_decoder(params, recording)
    samples = PoseSamples()
    readings: list[tuple[int, PoseReading]] = []
    for message in recording.messages([params["topic"]]):
        samples.counts.read += 1
        try:
            reading = decode(recording.decode(message))
        except DecodeError as err:
            samples.fail(str(err))
            continue
        readings.append((stamp_of(params, message, reading.stamp_ns), reading))
    child_SE3_ego: dict[str, SE3] = {}
    for stamp_ns, reading in readings:
        child = params["frame"] or reading.child or params["ego_frame"]
        if child not in child_SE3_ego:
            child_SE3_ego[child] = _static(params, frames, child)
        samples.global_frame = samples.global_frame or reading.parent
        if reading.parent != samples.global_frame:
            samples.counts.lose("it is in another frame than the first pose")
            continue
        samples.stamps_ns.append(stamp_ns)
        samples.poses.append(reading.parent_SE3_child @ child_SE3_ego[child])
    return samples


def _pose_decoder(params: Mapping[str, Any], recording: Recording) -> Callable[[Any], PoseReading]:
    msgtype = recording.topics[params["topic"]].msgtype
    decoder = plugin_decoder("pose", msgtype, params.get("decoder")) or _DECODERS.get(msgtype)
    if decoder is None:
        raise PoseError(
            f"ego poses: topic {params['topic']} carries {msgtype}, expected Odometry, PoseStamped or "
            f"PoseWithCovarianceStamped; {installed_decoders().advice('pose', msgtype)}"
        )
    return decoder


def _static(params: Mapping[str, Any], frames: RigFrames, child: str) -> SE3:
    """Return `child_SE3_ego`, which must be fixed."""
    ego = params["ego_frame"]
    if child == ego:
        return SE3()
    try:
        return frames.fixed(child, ego)[0]
    except CalibrationError as err:
        raise PoseError(
            f"{params['topic']} gives poses of {child}, not of {ego}: {err}. Correct ego_frame in the recipe, or "
            "name in ego_pose.frame the frame whose pose this is."
        ) from err
