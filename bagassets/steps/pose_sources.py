"""The sources of ego poses: each turns messages into samples of `global_SE3_ego`.

Every source returns stamps and poses in the order read, unsorted, with counts of what was
read and lost; `bagassets.steps.ego_poses` sorts, merges and writes them.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import isnan, sqrt
from typing import Any

import numpy as np

from bagassets.bags.model import RawMessage, Recording
from bagassets.decode.imu import decode_imu
from bagassets.decode.model import PoseReading
from bagassets.decode.navsat import FixReading, decode_navsat
from bagassets.decode.odometry import decode_odometry
from bagassets.decode.pose import decode_pose
from bagassets.decode.registry import plugin_decoder
from bagassets.errors import CalibrationError, DecodeError, PoseError
from bagassets.geometry.portable import arctan2, sin_cos
from bagassets.geometry.se3 import IDENTITY_QUATERNION, SE3, Floats
from bagassets.geometry.tf_tree import TfTree
from bagassets.geometry.trajectory import Trajectory
from bagassets.geometry.wgs84 import LocalFrame, utm
from bagassets.plugins import installed_decoders
from bagassets.steps.channel import Counts
from bagassets.steps.transform_logs import read_transforms

__all__ = ["PoseSamples", "read_samples", "wgs84_origin"]

_DECODERS: Mapping[str, Callable[[Any], PoseReading]] = {
    "geometry_msgs/msg/PoseStamped": decode_pose,
    "geometry_msgs/msg/PoseWithCovarianceStamped": decode_pose,
    "nav_msgs/msg/Odometry": decode_odometry,
}
# Course over ground is noise while the vehicle stands: below this the last heading holds.
LEAST_STEP_M = 0.2


@dataclass
class PoseSamples:
    """Samples of `global_SE3_ego` in the order read.

    Attributes:
        stamps_ns: time of each pose.
        poses: the poses.
        global_frame: name of the frame they are in.
        origin: where that frame lies on Earth, if it is known.
        counts: where the messages went.
    """

    stamps_ns: list[int] = field(default_factory=list)
    poses: list[SE3] = field(default_factory=list)
    global_frame: str = ""
    origin: dict[str, Any] | None = None
    counts: Counts = field(default_factory=Counts)


def read_samples(params: Mapping[str, Any], recording: Recording) -> PoseSamples:
    """Return the samples of the source that `params` name.

    Raises:
        PoseError: the source has no usable pose, or its frame cannot be related to the ego frame.
    """
    match params["source"]:
        case "odometry" | "pose":
            return _from_poses(params, recording)
        case "tf":
            return _from_tf(params, recording)
        case _:
            return _from_navsat(params, recording)


def _stamp(params: Mapping[str, Any], message: RawMessage, header_ns: int) -> int:
    return header_ns if params["clock"] == "header" else message.log_time_ns


def _from_poses(params: Mapping[str, Any], recording: Recording) -> PoseSamples:
    decode = _pose_decoder(params, recording)
    samples = PoseSamples()
    readings: list[tuple[int, PoseReading]] = []
    for message in recording.messages([params["topic"]]):
        samples.counts.read += 1
        try:
            reading = decode(recording.decode(message))
        except DecodeError as err:
            samples.counts.lose(str(err))
            continue
        readings.append((_stamp(params, message, reading.stamp_ns), reading))
    child_SE3_ego: dict[str, SE3] = {}
    for stamp_ns, reading in readings:
        child = params["frame"] or reading.child or params["ego_frame"]
        if child not in child_SE3_ego:
            child_SE3_ego[child] = _static(params, recording, child)
        samples.stamps_ns.append(stamp_ns)
        samples.poses.append(reading.parent_SE3_child @ child_SE3_ego[child])
        samples.global_frame = samples.global_frame or reading.parent
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


def _static(params: Mapping[str, Any], recording: Recording, child: str) -> SE3:
    """Return `child_SE3_ego`, which must be fixed."""
    ego = params["ego_frame"]
    if child == ego:
        return SE3()
    tree = TfTree(read_transforms(recording, params["tf_static"], "tf_static"))
    try:
        return tree.fixed(child, ego)[0]
    except CalibrationError as err:
        raise PoseError(
            f"{params['topic']} gives poses of {child}, not of {ego}: {err}. Correct ego_frame in the recipe, or "
            "record /tf_static."
        ) from err


def _from_tf(params: Mapping[str, Any], recording: Recording) -> PoseSamples:
    samples = PoseSamples(global_frame=params["global_frame"])
    static = read_transforms(recording, params["tf_static"], "tf_static")
    moving = read_transforms(recording, params["tf"], "tf", samples.counts)
    tree = TfTree(static, moving)
    dst, src = params["global_frame"], params["ego_frame"]
    try:
        up, down = tree.chain(dst, src)
    except CalibrationError as err:
        raise PoseError(
            f"ego poses from TF: {err}. Correct global_frame or ego_frame in the recipe."
        ) from err
    on_way = [edge.stamps_ns for edge in (*up, *down) if edge.moves]
    if not on_way:
        raise PoseError(
            f"ego poses from TF: nothing between {dst} and {src} moves; a rig that stands still says "
            "`source: fixed` in the recipe."
        )
    stamps_ns = np.unique(np.concatenate(on_way))
    max_gap_ns, extrapolate_ns = round(params["max_gap_s"] * 1e9), round(params["extrapolate_s"] * 1e9)
    positions, rotations, valid = tree.at(dst, src, stamps_ns, max_gap_ns, extrapolate_ns)
    # Transforms of other edges are read but make no pose: they are merged into those that do.
    used = int(valid.sum())
    samples.counts.merged, samples.counts.written = samples.counts.written - used, used
    samples.stamps_ns = [int(stamp) for stamp in stamps_ns[valid]]
    samples.poses = [SE3.create(q, t) for q, t in zip(rotations[valid], positions[valid], strict=True)]
    return samples


def _from_navsat(params: Mapping[str, Any], recording: Recording) -> PoseSamples:
    samples = PoseSamples(global_frame="enu")
    fixes: list[tuple[int, FixReading]] = []
    turns: list[tuple[int, tuple[float, float, float, float]]] = []
    for message in recording.messages([topic for topic in (params["topic"], params["imu"]) if topic]):
        if message.topic == params["topic"]:
            samples.counts.read += 1
        try:
            decoded = recording.decode(message)
            if message.topic == params["topic"]:
                fix = decode_navsat(decoded)
                fixes.append((_stamp(params, message, fix.stamp_ns), fix))
            else:
                imu = decode_imu(decoded)
                turns.append((_stamp(params, message, imu.stamp_ns), imu.enu_Q_imu))
        except DecodeError as err:
            if message.topic == params["topic"]:
                samples.counts.lose(str(err))
    if not fixes:
        return samples
    fixes.sort(key=lambda item: item[0])
    first = fixes[0][1]
    frame = LocalFrame(first.lat_deg, first.lon_deg, 0.0 if isnan(first.alt_m) else first.alt_m)
    samples.origin = wgs84_origin(frame)
    positions_m = frame.to_local(
        np.array([fix.lat_deg for _, fix in fixes]),
        np.array([fix.lon_deg for _, fix in fixes]),
        np.array([frame.alt_m if isnan(fix.alt_m) else fix.alt_m for _, fix in fixes]),
    )
    stamps = [stamp for stamp, _ in fixes]
    if params["imu"]:
        rotations, valid = _orientations(params, turns, stamps)
    else:
        rotations, valid = _courses(positions_m), [True] * len(positions_m)
    for stamp, position, rotation, known in zip(stamps, positions_m, rotations, valid, strict=True):
        if known:
            samples.stamps_ns.append(stamp)
            samples.poses.append(SE3.create(rotation, position))
        else:
            samples.counts.lose("no Imu orientation at its time")
    return samples


def _orientations(
    params: Mapping[str, Any], turns: list[tuple[int, tuple[float, float, float, float]]], stamps: list[int]
) -> tuple[list[tuple[float, ...]], list[bool]]:
    """Interpolate Imu orientations (REP-103: relative to east-north-up) at the stamps of the fixes."""
    by_stamp = dict(sorted(turns))
    track = Trajectory(
        np.array(list(by_stamp), dtype=np.int64),
        np.zeros((len(by_stamp), 3)),
        np.array(list(by_stamp.values())).reshape(-1, 4),
        round(params["max_gap_s"] * 1e9),
        round(params["extrapolate_s"] * 1e9),
    )
    _, rotations, valid = track.at(np.array(stamps, dtype=np.int64))
    return [tuple(float(v) for v in row) for row in rotations], [bool(v) for v in valid]


def _courses(positions_m: Floats) -> list[tuple[float, ...]]:
    """Headings along (N, 3) positions; while the vehicle stands, the heading before holds."""
    headings: list[tuple[float, ...] | None] = [None] * len(positions_m)
    anchor = 0
    for i in range(1, len(positions_m)):
        east, north = (float(v) for v in positions_m[i, :2] - positions_m[anchor, :2])
        if sqrt(east * east + north * north) < LEAST_STEP_M:
            headings[i] = headings[anchor]
            continue
        sine, cosine = sin_cos(arctan2(np.array(north), np.array(east)) / 2)
        heading = (float(cosine), 0.0, 0.0, float(sine))
        headings[anchor:i] = [heading] * (i - anchor)
        headings[i] = heading
        anchor = i
    first = next((heading for heading in headings if heading is not None), IDENTITY_QUATERNION)
    return [heading or first for heading in headings]


def wgs84_origin(frame: LocalFrame) -> dict[str, Any]:
    """Return where a local frame lies on Earth, as `ego_poses.json` says it."""
    origin = {"kind": "wgs84", "lat": frame.lat_deg, "lon": frame.lon_deg, "alt": frame.alt_m}
    grid = utm(frame.lat_deg, frame.lon_deg)
    if grid is None:
        return origin | {"utm_zone": None, "easting": None, "northing": None, "convergence_deg": None}
    return origin | {
        "utm_zone": grid.zone,
        "easting": round(grid.easting_m, 4),
        "northing": round(grid.northing_m, 4),
        "convergence_deg": round(grid.convergence_deg, 9),
    }
