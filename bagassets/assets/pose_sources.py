"""The sources of ego poses: each turns messages into samples of `global_SE3_ego`.

Every source returns stamps and poses in the order read, unsorted, with counts of what was
read and lost; `bagassets.assets.ego_poses` sorts, merges and writes them.
"""

from collections.abc import Callable

import numpy as np

from bagassets.assets.pose_gnss import poses_from_navsat
from bagassets.assets.pose_ncom import poses_from_ncom
from bagassets.assets.pose_samples import MovingRig, PoseSamples, stamp_of
from bagassets.assets.transform_logs import RigFrames, read_transforms
from bagassets.base.errors import CalibrationError, DecodeError, PoseError, UnsetError
from bagassets.decode.loading import keyed_decoder
from bagassets.decode.model import PoseReading
from bagassets.decode.registry import advice, own_types
from bagassets.geometry.se3 import SE3
from bagassets.geometry.tf_tree import TfTree
from bagassets.recipe.model_poses import (
    MovingPoseSource,
    NavSatSource,
    NcomSource,
    OdometrySource,
    PoseTopicSource,
    TfSource,
)
from bagassets.recordings.model import Message
from bagassets.recordings.recording import Recording


def read_samples(source: MovingPoseSource, rig: MovingRig, recording: Recording) -> PoseSamples:
    """Return the samples of a source.

    Raises:
        PoseError: the source has no usable pose, or its frame cannot be related to the ego frame.
    """
    if isinstance(source, TfSource):
        return _from_tf(source, rig, recording)
    frames = RigFrames(recording, rig.tf_static, rig.tf, rig.joints)
    match source:
        case NavSatSource():
            return poses_from_navsat(source, rig, recording, frames)
        case NcomSource():
            return poses_from_ncom(source, rig, recording, frames)
        case _:
            return _from_poses(source, rig, recording, frames)


def _from_tf(source: TfSource, rig: MovingRig, recording: Recording) -> PoseSamples:
    """Return a pose of a chain of transforms, `global_frame -> … -> ego_frame`, at every stamp of every moving edge on the way.

    Counts are of transforms: those of other edges, and those with a repeated stamp, are merged.

    Raises:
        PoseError: the frames are not connected, or nothing between them moves.
    """
    samples = PoseSamples(global_frame=source.global_frame)
    troubles: dict[str, str] = {}
    static = read_transforms(recording, rig.tf_static, "tf_static", troubles=troubles)
    moving = read_transforms(recording, rig.tf, "tf", samples.counts, clock=rig.clock, troubles=troubles)
    dst, src = source.global_frame, rig.ego_frame
    tree = TfTree(static, rig.joints, moving)
    try:
        up, down = tree.chain(dst, src)
    except CalibrationError as err:
        unusable = [
            f" Some transforms in {topic} cannot be used: {reason}." for topic, reason in troubles.items()
        ]
        raise PoseError(
            f"ego poses from TF: {err}.{''.join(unusable)} Correct global_frame or ego_frame in the recipe."
        ) from err
    moved = {(edge.parent, edge.child): edge for edge in moving if edge.moves}
    for edge in (*up, *down):
        if edge.moves and edge.source != "tf":
            raise PoseError(
                f"ego poses from TF: {edge.parent} -> {edge.child} is published as static ({', '.join(rig.tf_static)}) "
                "with different values; repair the recording, or leave the topic out of tf_static in the recipe."
            )
        if not edge.moves and (other := moved.get((edge.parent, edge.child))):
            raise PoseError(
                f"ego poses from TF: {edge.parent} -> {edge.child} is fixed in {', '.join(edge.topics) or edge.source} "
                f"and moves in {', '.join(other.topics)}; correct the publisher, or leave one of them out of the recipe."
            )
    on_way = [edge.stamps_ns for edge in (*up, *down) if edge.moves]
    if not on_way:
        raise PoseError(
            f"ego poses from TF: nothing between {dst} and {src} moves; for a stationary rig, set "
            "`source: fixed` in the recipe."
        )
    stamps_ns = np.unique(np.concatenate(on_way))
    max_gap_ns, extrapolate_ns = round(source.max_gap_s * 1e9), round(source.extrapolate_s * 1e9)
    positions, rotations, valid = tree.at(dst, src, stamps_ns, max_gap_ns, extrapolate_ns)
    used = int(valid.sum())
    without = len(stamps_ns) - used
    samples.counts.merged = samples.counts.written - len(stamps_ns)
    samples.counts.written = used
    if without:
        samples.counts.lose("other transforms on the way have no value at its time", without)
    samples.stamps_ns = [int(stamp) for stamp in stamps_ns[valid]]
    samples.poses = [SE3.create(q, t) for q, t in zip(rotations[valid], positions[valid], strict=True)]
    return samples


def _from_poses(
    source: OdometrySource | PoseTopicSource, rig: MovingRig, recording: Recording, frames: RigFrames
) -> PoseSamples:
    msgtype = recording.topics[source.topic].msgtype
    decode: Callable[[Message], PoseReading] | None = keyed_decoder("pose", msgtype, rig.decoder)
    if decode is None:
        *names, last = (known.rpartition("/")[2] for known in own_types("pose"))
        raise PoseError(
            f"ego poses: topic {source.topic} carries {msgtype}, expected {', '.join(names)} or {last}; "
            f"{advice('pose', msgtype)}"
        )
    samples = PoseSamples()
    readings: list[tuple[int, PoseReading]] = []
    for message in recording.messages([source.topic]):
        samples.counts.read += 1
        try:
            reading = decode(recording.decode(message))
        except UnsetError:
            samples.counts.lose("its quaternion is zero")  # not a failure: nothing is damaged
            continue
        except DecodeError as err:
            samples.fail(str(err))
            continue
        readings.append((stamp_of(rig.clock, message, reading.stamp_ns), reading))
    ego = rig.ego_frame
    child_SE3_ego: dict[str, SE3] = {}
    for stamp_ns, reading in readings:
        child = source.frame or reading.child or ego
        if child not in child_SE3_ego:
            try:
                child_SE3_ego[child] = SE3() if child == ego else frames.fixed(child, ego)[0]
            except CalibrationError as err:
                raise PoseError(
                    f"{source.topic} gives poses of {child}, not of {ego}: {err}. Correct ego_frame in the recipe, or "
                    "name in ego_pose.frame the frame whose pose this is."
                ) from err
        samples.global_frame = samples.global_frame or reading.parent
        if reading.parent != samples.global_frame:
            samples.counts.lose("it is in another frame than the first pose")
            continue
        samples.stamps_ns.append(stamp_ns)
        samples.poses.append(reading.parent_SE3_child @ child_SE3_ego[child])
    return samples
