"""The asset `ego_poses`: the trajectory of the ego frame, in local metres.

Files: `ego_poses.parquet` (stamp_ns, x, y, z, qw, qx, qy, qz) and `ego_poses.json`.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa

from bagassets.assets.asset import Asset, Facts, Inputs, Summary, Use
from bagassets.assets.face import Face, Loss, Table, counts_table, losses_of
from bagassets.assets.inventory import INVENTORY
from bagassets.assets.pose_outliers import Mask, Stamps, overlaps, strays
from bagassets.assets.pose_samples import Joint, MovingRig, PoseSamples, counted_in_poses
from bagassets.assets.pose_sources import read_samples
from bagassets.assets.quality.finding import clock
from bagassets.assets.transform_logs import read_urdf
from bagassets.base.columns import column, numbers
from bagassets.base.errors import LossLimitError, PoseError
from bagassets.base.json_types import Json, JsonMapping, JsonObject
from bagassets.decode.registry import decoder_key, types_of
from bagassets.geometry.se3 import SE3, Floats
from bagassets.geometry.trajectory import Trajectory
from bagassets.geometry.urdf import urdf_edges
from bagassets.recipe.model import Recipe, Rig
from bagassets.recipe.model_base import Clock
from bagassets.recipe.model_poses import (
    FixedPose,
    MovingPoseSource,
    NavSatSource,
    OdometrySource,
    PoseTopicSource,
    TfSource,
)
from bagassets.recordings.inventory import Inventory
from bagassets.recordings.recording import Recording
from bagassets.store.artifact import Artifact, ArtifactWriter

# Coordinates beyond this lose centimetres in the float32 arithmetic of training code.
FAR_M = 100_000.0

_NUMBERS = ("x", "y", "z", "qw", "qx", "qy", "qz")
POSE_SCHEMA = pa.schema({"stamp_ns": pa.int64(), **dict.fromkeys(_NUMBERS, pa.float64())})
"""Columns of `ego_poses.parquet`."""


@dataclass(frozen=True)
class MovingRigParams:
    """Parameters of `ego_poses` for a moving rig.

    Attributes:
        source: the source of the poses.
        clock: which time of a message counts.
        ego_frame: the frame whose poses are wanted.
        lost_messages: share of messages that may fail to give a pose.
        tf_static: topics with static transforms.
        tf: topics with transforms.
        urdf: URDF file, whose fixed joints are used.
    """

    source: MovingPoseSource
    clock: Clock
    ego_frame: str
    lost_messages: float
    tf_static: tuple[str, ...]
    tf: tuple[str, ...]
    urdf: Path | None


@dataclass(frozen=True)
class Unposed:
    """Parameters of `ego_poses` for a rig that the recipe gives no source of poses: its trajectory is empty."""

    source: None = None


def params(recipe: Recipe, rig: Rig) -> FixedPose | Unposed | MovingRigParams:
    """Return the parameters of a rig; for a stationary one, that is its pose and nothing else."""
    if rig.ego_pose is None:
        return Unposed()
    if isinstance(rig.ego_pose, FixedPose):
        return rig.ego_pose
    return MovingRigParams(
        rig.ego_pose,
        recipe.clock_of(rig),
        rig.ego_frame,
        recipe.limits.lost_messages,
        rig.tf_static,
        rig.tf,
        rig.urdf,
    )


def use(
    params: FixedPose | Unposed | MovingRigParams, facts: Facts
) -> dict[str, Use[FixedPose | Unposed | MovingRig]]:
    """Return what the poses of a recording depend on.

    Raises:
        PoseError: the configured topic is not in the recording.
        CalibrationError: the URDF cannot be used.
        PluginError: several decoder plug-ins claim the type of the topic.
    """
    if isinstance(params, FixedPose | Unposed):
        return {"": Use(params)}
    source, inventory = params.source, facts.inventory
    joints: tuple[Joint, ...] = ()
    if params.urdf is not None:
        edges = urdf_edges(read_urdf(params.urdf, facts), str(params.urdf))
        joints = tuple(Joint(e.parent, e.child, e.first.translation, e.first.rotation) for e in edges)
    static = tuple(filter(inventory.has, params.tf_static))
    moving = tuple(filter(inventory.has, params.tf))
    # What a recording must have for its poses.
    if isinstance(source, TfSource):
        topics = [] if moving else [params.tf[0] if params.tf else "/tf"]
    else:
        topics = [source.topic]
    if isinstance(source, NavSatSource) and source.imu is not None:
        topics.append(source.imu)
    for topic in topics:
        _require(topic, inventory)
    decoder = None
    if isinstance(source, OdometrySource | PoseTopicSource):
        decoder = decoder_key("pose", inventory.topic(source.topic).msgtype)
    rig = MovingRig(**vars(params) | {"urdf": joints, "tf_static": static, "tf": moving, "decoder": decoder})
    return {"": Use(rig, tuple(sorted({*static, *moving, *topics})))}


def _require(topic: str, inventory: Inventory) -> None:
    if inventory.has(topic):
        return
    kinds = {*types_of("pose"), *types_of("fix"), *types_of("transforms")}
    candidates = [name for name, record in inventory.topics.items() if record.msgtype in kinds]
    offer = f"it has {', '.join(candidates)}" if candidates else "it has no topic with poses"
    raise PoseError(
        f"ego poses: the recording has no messages on {topic}, which ego_pose reads; {offer}. Correct "
        "ego_pose in the recipe; for a stationary rig, set `source: fixed`."
    )


def make_ego_poses(
    use: FixedPose | Unposed | MovingRig, recording: Recording, out: ArtifactWriter
) -> Summary:
    """Write the trajectory, which is empty without a source of poses, and return the summary.

    Raises:
        PoseError: there is no usable pose.
        LossLimitError: more messages were lost than the recipe allows.
    """
    if isinstance(use, Unposed):
        nowhere = PoseSamples(global_frame="global")
        return _write(use, nowhere, np.zeros(0, dtype=np.int64), np.zeros((0, len(_NUMBERS))), out)
    if isinstance(use, FixedPose):
        pose = SE3.create(use.pose.rotation, use.pose.translation)
        samples = PoseSamples([0], [pose], global_frame="global")
        return _write(use, samples, *_ordered(samples)[:2], out)
    samples = read_samples(use.source, use, recording)
    counts = samples.counts
    if not samples.poses:
        read = f"{counts.read} {counted_in_poses(use.source.source)}s"
        lost = "; ".join(f"{number} because {reason}" for reason, number in counts.lost.items())
        raise PoseError(
            f"ego poses from {use.source_name}: none of {read} gives a pose"
            f"{' (' + lost + ')' if lost else ''}; name another topic, or TF, as ego_pose in the recipe."
        )
    stamps_ns, rows, repeated = _ordered(samples)
    if repeated and stamps_ns.tolist() == [0]:
        raise PoseError(
            f"ego poses from {use.source_name}: all header stamps are zero; set `clock: log` in the recipe."
        )
    kept = _without_overlaps(use, samples, stamps_ns, rows)
    stamps_ns, rows = stamps_ns[kept], rows[kept]
    kept = ~strays(stamps_ns, rows[:, :3])
    samples.lose_strays(kept)
    stamps_ns, rows = stamps_ns[kept], rows[kept]
    if samples.failed > use.lost_messages * counts.read:
        raise LossLimitError(
            f"ego poses from {use.source_name}: {samples.failed} of {counts.read} "
            f"{counted_in_poses(use.source.source)}s cannot be used, most often because {counts.main_reason}; limits.lost_messages in the recipe accepts a share of {use.lost_messages:g}."
        )
    counts.merged += repeated
    counts.written = len(stamps_ns)
    if not counts.balanced:
        raise PoseError(f"ego poses: counts do not add up, {counts.as_json()}; please report this.")
    return _write(use.source, samples, stamps_ns, rows, out)


def _write(
    source: FixedPose | Unposed | MovingPoseSource,
    samples: PoseSamples,
    stamps_ns: Stamps,
    rows: Floats,
    out: ArtifactWriter,
) -> Summary:
    """Write (N,) stamps and (N, 7) poses, and facts about them; return the summary."""
    origin = samples.origin or (_recentre(rows) if len(rows) else None)
    columns = [column(stamps_ns, pa.int64()), *(column(one, pa.float64()) for one in rows.T)]
    out.write_table("ego_poses.parquet", pa.Table.from_arrays(columns, schema=POSE_SCHEMA))
    steps = np.diff(rows[:, :3], axis=0)
    summary = {
        "source": source.source,
        "count": len(stamps_ns),
        "counts": samples.counts.as_json(),
        "length_m": round(float(np.sqrt((steps * steps).sum(axis=1)).sum()), 3),
        "notes": samples.notes,
        "helpers": {topic: helper.as_json() for topic, helper in sorted(samples.helpers.items())},
    }
    max_gap_s, extrapolate_s = (
        (0.0, 0.0) if isinstance(source, FixedPose | Unposed) else (source.max_gap_s, source.extrapolate_s)
    )
    out.write_json(
        "ego_poses.json",
        summary
        | {
            "fixed": isinstance(source, FixedPose),
            "max_gap_s": max_gap_s,
            "extrapolate_s": extrapolate_s,
            "global_frame": samples.global_frame,
            "origin": origin,
        }
        | ({"holes_ns": samples.holes_ns} if samples.holes_ns else {}),
    )
    return summary


def load_trajectory(artifact: Artifact) -> Trajectory:
    """Return the trajectory in an artifact of this step."""
    facts = artifact.read_json("ego_poses.json")
    table = artifact.read_table("ego_poses.parquet")
    values = np.stack([numbers(table[name]) for name in _NUMBERS], axis=1)
    return Trajectory(
        numbers(table["stamp_ns"]).astype(np.int64),
        np.ascontiguousarray(values[:, :3]),
        np.ascontiguousarray(values[:, 3:]),
        round(facts["max_gap_s"] * 1e9),
        round(facts["extrapolate_s"] * 1e9),
        fixed=facts["fixed"],
        holes_ns=tuple((first, last) for first, last in facts.get("holes_ns", ())),
    )


def _ordered(samples: PoseSamples) -> tuple[Stamps, Floats, int]:
    """Sort by stamp; of poses with the same stamp, keep the first one read. Return how many were not."""
    first: dict[int, SE3] = {}
    for stamp_ns, pose in zip(samples.stamps_ns, samples.poses, strict=True):
        first.setdefault(stamp_ns, pose)
    stamps_ns = np.array(sorted(first), dtype=np.int64)
    poses = (first[stamp_ns] for stamp_ns in stamps_ns.tolist())
    rows = np.array([[*pose.translation, *pose.rotation] for pose in poses])
    return stamps_ns, rows, len(samples.poses) - len(stamps_ns)


def _without_overlaps(use: MovingRig, samples: PoseSamples, stamps_ns: Stamps, rows: Floats) -> Mask:
    """Count poses at times that two trajectories share, and return (N,) which others are kept.

    What was sensed at these times has no pose, since nobody knows which of the two times it was.

    Raises:
        PoseError: these are nearly all poses, or most of them in more pieces than clocks that are set leave.
    """
    kept = np.ones(len(rows), np.bool_)
    for first, last in overlaps(rows):
        kept[first : last + 1] = False
        around = stamps_ns[[max(first - 1, 0), min(last + 1, len(rows) - 1)]]
        samples.holes_ns.append((int(around[0]), int(around[1])))
    lost = np.flatnonzero(~kept)
    nearly_all = len(lost) > 0.9 * len(rows)
    if nearly_all or (len(lost) > 0.5 * len(rows) and len(samples.holes_ns) > 2):
        other = "" if nearly_all else f", or try `clock: {'log' if use.clock == 'header' else 'header'}`"
        raise PoseError(
            f"ego poses from {use.source_name}: {len(lost)} of {len(rows)} poses go to and fro between two trajectories, first at "
            f"{clock(int(stamps_ns[lost[0]]))}: two nodes publish, or a clock was set back. Name a topic, or TF frames, that one "
            f"node publishes in ego_pose of the recipe{other}."
        )
    if len(lost):
        samples.counts.lose("two trajectories overlap at its time", len(lost))
    return kept


def _recentre(rows: Floats) -> JsonObject | None:
    """Move far-away coordinates, such as UTM, to a local origin, and return it."""
    if np.abs(rows[:, :2]).max() <= FAR_M:
        return None
    # The first pose may be one of a source that does not know yet where it is.
    near = np.abs(rows[:, :2] - np.median(rows[:, :2], axis=0)).max(axis=1) <= FAR_M
    origin = [float(np.floor(v)) for v in rows[int(np.argmax(near)), :3]]
    rows[:, :3] -= np.array(origin)
    return {"kind": "local", "x": origin[0], "y": origin[1], "z": origin[2]}


def _make(use: Use[FixedPose | Unposed | MovingRig], inputs: Inputs, out: ArtifactWriter) -> Summary:
    with inputs.messages(use.topics) as recording:
        return make_ego_poses(use.params, recording, out)


def _shown(artifact: Artifact) -> Mapping[str, Json | Table]:
    summary = dict(artifact.summary())
    counts = {"all": summary.pop("counts")}
    return {"counts": counts_table(counts, f"{counted_in_poses(summary['source'])}s"), **summary}


def _losses(summary: JsonMapping) -> list[Loss]:
    return losses_of(EGO_POSES.name, summary.get("counts", {}), counted_in_poses(summary.get("source", "")))


def _has_fixed_edges(use: FixedPose | Unposed | MovingRig) -> bool:
    """Return whether poses come from TF that may be fixed in one place and move in another."""
    return isinstance(use, MovingRig) and isinstance(use.source, TfSource) and bool(use.tf_static or use.urdf)


EGO_POSES = Asset(
    name="ego_poses",
    version=5,
    changes={
        4: "leaves out stray fixes, zero quaternions and what was recorded twice",
        5: "refuses an edge of TF that is fixed in one place and moves in another",
    },
    spared={5: lambda use: not _has_fixed_edges(use)},
    libraries=("pyarrow",),
    title="Where the vehicle was, over time, in local metres.",
    description="""From odometry, poses, TF, GNSS with IMU, or fixed; the origin in the world is kept where it is known:
`ego_poses.parquet`.""",
    kinds=frozenset({"parquet"}),
    face=Face(
        columns=POSE_SCHEMA,
        shown=_shown,
        counts={"poses": lambda summary: summary.get("count")},
        losses=_losses,
    ),
    reads=(INVENTORY,),
    families=("pose",),
    params=params,
    use=use,
    make=_make,
)
