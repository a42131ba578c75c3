"""The step `ego_poses`: the trajectory of the ego frame in local metres.

Files: `ego_poses.parquet` (stamp_ns, x, y, z, qw, qx, qy, qz) and `ego_poses.json`.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pyarrow as pa

from bagassets.bags.inventory import Inventory
from bagassets.bags.model import Recording
from bagassets.decode.registry import decoder_params
from bagassets.errors import CalibrationError, LossLimitError, PoseError
from bagassets.geometry.se3 import SE3
from bagassets.geometry.trajectory import Trajectory
from bagassets.geometry.urdf import urdf_edges
from bagassets.recipe.model import Limits, Rig
from bagassets.recipe.model_base import Clock
from bagassets.recipe.model_poses import (
    FixedPose,
    NavSatSource,
    OdometrySource,
    PoseTopicSource,
    TfSource,
)
from bagassets.steps.channel import Counts, Request
from bagassets.steps.pose_samples import strays
from bagassets.steps.pose_sources import PoseSamples, read_samples
from bagassets.store.action import Step
from bagassets.store.artifact import Artifact, ArtifactWriter

__all__ = ["STEP", "load_trajectory", "make", "request"]

STEP = Step("ego_poses", 3, ("pyarrow",))

# Coordinates beyond this lose centimetres in the float32 arithmetic of training code.
FAR_M = 100_000.0

_NUMBERS = ("x", "y", "z", "qw", "qx", "qy", "qz")


def request(rig: Rig, clock: Clock, inventory: Inventory, limits: Limits | None = None) -> Request:
    """Return what the step reads of this recording.

    Args:
        rig: the rig that made the recording.
        clock: which time of a message counts.
        inventory: what is in the recording.
        limits: accepted losses; those of an empty recipe by default.

    Raises:
        PoseError: the configured topic is not in the recording.
        CalibrationError: the URDF cannot be used.
        PluginError: several decoder plug-ins claim its type.
    """
    source = rig.ego_pose
    if isinstance(source, FixedPose):
        return Request({"source": "fixed", "pose": source.pose.model_dump(mode="json")}, ())
    params: dict[str, Any] = {"clock": clock, "ego_frame": rig.ego_frame}
    params |= source.model_dump(mode="json")
    params |= {"lost_messages": (limits or Limits()).lost_messages, "urdf": _fixed_joints(rig)}
    params["tf_static"] = [topic for topic in rig.tf_static if inventory.has(topic)]
    params["tf"] = [topic for topic in rig.tf if inventory.has(topic)]
    topics = [*params["tf_static"], *params["tf"]]
    if isinstance(source, TfSource):
        if not params["tf"]:
            _require(rig, inventory, rig.tf[0] if rig.tf else "/tf")
        return Request(params, tuple(sorted(set(topics))))
    _require(rig, inventory, source.topic)
    topics.append(source.topic)
    if isinstance(source, NavSatSource) and source.imu is not None:
        _require(rig, inventory, source.imu)
        topics.append(source.imu)
    if isinstance(source, OdometrySource | PoseTopicSource):
        params |= decoder_params("pose", inventory.topic(source.topic).msgtype)
    return Request(params, tuple(sorted(set(topics))))


def _fixed_joints(rig: Rig) -> list[list[Any]]:
    """Return the fixed joints of the URDF as JSON: what else is in the file makes nothing stale."""
    if rig.urdf is None:
        return []
    try:
        data = rig.urdf.read_bytes()
    except OSError as err:
        raise CalibrationError(f"{rig.urdf}: the URDF cannot be read ({err.strerror}).") from err
    edges = urdf_edges(data, str(rig.urdf))
    return [
        [edge.parent, edge.child, list(edge.first.translation), list(edge.first.rotation)] for edge in edges
    ]


def _require(rig: Rig, inventory: Inventory, topic: str) -> None:
    if inventory.has(topic):
        return
    kinds = ("Odometry", "PoseStamped", "PoseWithCovarianceStamped", "NavSatFix", "TFMessage", "tfMessage")
    there = [name for name, record in inventory.topics.items() if record.msgtype.rsplit("/", 1)[-1] in kinds]
    offer = f"it has {', '.join(there)}" if there else "it has no topic with poses"
    raise PoseError(
        f"rig {rig.name}: the recording has no messages on {topic}, which ego_pose reads; {offer}. Correct "
        "ego_pose in the recipe; a rig that stands still says `source: fixed`."
    )


def make(params: Mapping[str, Any], recording: Recording, out: ArtifactWriter) -> dict[str, Any]:
    """Write the trajectory and return the summary.

    Raises:
        PoseError: there is no usable pose.
        LossLimitError: more messages were lost than the recipe allows.
    """
    if params["source"] == "fixed":
        pose = SE3.create(params["pose"]["rotation"], params["pose"]["translation"])
        samples = PoseSamples([0], [pose], "global", None, Counts(read=0, written=0))
    else:
        samples = read_samples(params, recording)
        if not samples.poses:
            lost = "; ".join(f"{number} because {reason}" for reason, number in samples.counts.lost.items())
            raise PoseError(
                f"ego poses from {params.get('topic', 'TF')}: none of {samples.counts.read} messages gives a pose"
                f"{' (' + lost + ')' if lost else ''}; correct ego_pose in the recipe."
            )
    stamps_ns, rows, repeated = _ordered(samples)
    if stamps_ns == [0] and repeated:
        raise PoseError(
            f"ego poses from {params.get('topic', 'TF')}: all header stamps are zero; set `clock: log` in the recipe."
        )
    stamps_ns, rows = _without_strays(samples, stamps_ns, rows)
    _check_losses(params, samples)
    counts = samples.counts
    if params["source"] != "fixed":
        counts.merged += repeated
        counts.written = len(stamps_ns)
        if not counts.balanced:
            raise PoseError(f"ego poses: counts do not add up, {counts.as_json()}; please report this.")
    origin = samples.origin or _recentre(rows)
    table = {"stamp_ns": pa.array(stamps_ns, pa.int64())}
    table |= {name: pa.array(rows[:, i], pa.float64()) for i, name in enumerate(_NUMBERS)}
    out.write_table("ego_poses.parquet", pa.table(table))
    steps = np.diff(rows[:, :3], axis=0)
    length_m = round(float(np.sqrt((steps * steps).sum(axis=1)).sum()), 3)
    facts = {
        "source": params["source"],
        "count": len(stamps_ns),
        "counts": counts.as_json(),
        "length_m": length_m,
        "notes": samples.notes,
        "helpers": {topic: helper.as_json() for topic, helper in sorted(samples.helpers.items())},
    }
    out.write_json(
        "ego_poses.json",
        facts
        | {
            "fixed": params["source"] == "fixed",
            "max_gap_s": params.get("max_gap_s", 0.0),
            "extrapolate_s": params.get("extrapolate_s", 0.0),
            "global_frame": samples.global_frame,
            "origin": origin,
        },
    )
    return facts


def _check_losses(params: Mapping[str, Any], samples: PoseSamples) -> None:
    counts = samples.counts
    if samples.failed > params.get("lost_messages", 0.0) * counts.read:
        reason = max(counts.lost, key=lambda name: counts.lost[name])
        raise LossLimitError(
            f"ego poses from {params.get('topic', 'TF')}: {samples.failed} of {counts.read} messages cannot be used, most often "
            f"because {reason}; limits.lost_messages in the recipe accepts a share of {params['lost_messages']:g}."
        )


def load_trajectory(artifact: Artifact) -> Trajectory:
    """Return the trajectory in an artifact of this step."""
    facts = artifact.read_json("ego_poses.json")
    table = artifact.read_table("ego_poses.parquet")
    numbers = np.stack([table[name].to_numpy() for name in _NUMBERS], axis=1)
    return Trajectory(
        table["stamp_ns"].to_numpy().astype(np.int64),
        np.ascontiguousarray(numbers[:, :3]),
        np.ascontiguousarray(numbers[:, 3:]),
        round(facts["max_gap_s"] * 1e9),
        round(facts["extrapolate_s"] * 1e9),
        fixed=facts["fixed"],
    )


def _ordered(samples: PoseSamples) -> tuple[list[int], np.ndarray[Any, np.dtype[np.float64]], int]:
    """Sort by stamp; of poses with the same stamp the first one read counts."""
    first: dict[int, SE3] = {}
    for stamp_ns, pose in zip(samples.stamps_ns, samples.poses, strict=True):
        first.setdefault(stamp_ns, pose)
    stamps_ns = sorted(first)
    rows = np.array([[*first[stamp].translation, *first[stamp].rotation] for stamp in stamps_ns])
    return stamps_ns, rows, len(samples.poses) - len(stamps_ns)


def _without_strays(
    samples: PoseSamples, stamps_ns: list[int], rows: "np.ndarray[Any, np.dtype[np.float64]]"
) -> tuple[list[int], "np.ndarray[Any, np.dtype[np.float64]]"]:
    """Leave out poses that nothing could have driven to and back from, and count them."""
    out_of_reach = strays(stamps_ns, rows[:, :3])
    number = int(out_of_reach.sum())
    if number:
        samples.counts.lose("its position is out of reach from those before and after it", number)
        # Many sources begin at zero, and then find out where they are: that is no damage.
        samples.failed += int(out_of_reach[1:-1].sum())
    kept = ~out_of_reach
    return [stamp for stamp, keep in zip(stamps_ns, kept, strict=True) if keep], rows[kept]


def _recentre(rows: np.ndarray[Any, np.dtype[np.float64]]) -> dict[str, Any] | None:
    """Move far-away coordinates (UTM, say) to a local origin, which is returned."""
    if np.abs(rows[:, :2]).max() <= FAR_M:
        return None
    origin = [float(np.floor(v)) for v in rows[0, :3]]
    rows[:, :3] -= np.array(origin)
    return {"kind": "local", "x": origin[0], "y": origin[1], "z": origin[2]}
