"""Ego poses from a chain of transforms, `global_frame -> … -> ego_frame`."""

import numpy as np

from bagassets.assets.pose_samples import MovingRig, PoseSamples
from bagassets.assets.transform_logs import read_transforms
from bagassets.errors import CalibrationError, PoseError
from bagassets.geometry.se3 import SE3
from bagassets.geometry.tf_tree import TfTree
from bagassets.recipe.model_poses import TfSource
from bagassets.recordings.recording import Recording

__all__ = ["poses_from_tf"]

WITHOUT_OTHERS = "other transforms on the way have no value at its time"


def poses_from_tf(source: TfSource, rig: MovingRig, recording: Recording) -> PoseSamples:
    """Return a pose at every stamp of every moving edge on the way.

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
    for edge in (*up, *down):
        if edge.moves and edge.source != "tf":
            raise PoseError(
                f"ego poses from TF: {edge.parent} -> {edge.child} is published as static ({', '.join(rig.tf_static)}) "
                "with different values; repair the recording, or leave the topic out of tf_static in the recipe."
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
        samples.counts.lose(WITHOUT_OTHERS, without)
    samples.stamps_ns = [int(stamp) for stamp in stamps_ns[valid]]
    samples.poses = [SE3.create(q, t) for q, t in zip(rotations[valid], positions[valid], strict=True)]
    return samples
