"""Ego poses from `NavSatFix`, projected to local metres; orientation from an Imu or from the course."""

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from bagassets.assets.channel import Counts
from bagassets.assets.pose_outliers import trusted_fixes
from bagassets.assets.pose_samples import MovingRig, PoseSamples, mounted, stamp_of, wgs84_origin
from bagassets.assets.transform_logs import RigFrames
from bagassets.base.errors import DecodeError
from bagassets.decode.loading import own_decoder
from bagassets.decode.poses import FixReading, ImuReading
from bagassets.geometry.portable import arctan2, sin_cos
from bagassets.geometry.se3 import IDENTITY_QUATERNION, SE3, Floats, quaternion_multiply, rotate
from bagassets.geometry.trajectory import Trajectory, slerp
from bagassets.geometry.wgs84 import LocalFrame
from bagassets.recipe.model_poses import NavSatSource
from bagassets.recordings.recording import Recording

# Course over ground is noise while the vehicle stands: below this the last heading holds.
LEAST_STEP_M = 0.2


def poses_from_navsat(
    source: NavSatSource, rig: MovingRig, recording: Recording, frames: RigFrames
) -> PoseSamples:
    """Return a pose for each fix; the origin of the global frame is the first one that is in reach of the others.

    The mounts of antenna and Imu are taken into account if there are transforms for them.
    """
    samples = PoseSamples(global_frame="enu")
    fixes: list[tuple[int, FixReading]] = []
    turns: list[tuple[int, ImuReading]] = []
    imu_counts = Counts()
    for message in recording.messages([topic for topic in (source.topic, source.imu) if topic]):
        is_fix = message.topic == source.topic
        counts = samples.counts if is_fix else imu_counts
        counts.read += 1
        try:
            decoded = recording.decode(message)
        except DecodeError as err:
            lose = samples.fail if is_fix else counts.lose
            lose(str(err))
            continue
        try:
            if is_fix:
                fix: FixReading = own_decoder("fix", message.msgtype)(decoded)
                fixes.append((stamp_of(rig.clock, message, fix.stamp_ns), fix))
            else:
                imu: ImuReading = own_decoder("imu", message.msgtype)(decoded)
                turns.append((stamp_of(rig.clock, message, imu.stamp_ns), imu))
                counts.written += 1
        except DecodeError as err:
            counts.lose(str(err))  # not a failure: the receiver had no fix
    if source.imu:
        samples.helpers[source.imu] = imu_counts
    if not fixes:
        return samples
    fixes.sort(key=lambda item: item[0])
    stamps_ns = np.array([stamp for stamp, _ in fixes], dtype=np.int64)
    lat_deg, lon_deg, alt_m = (
        np.array([getattr(fix, name) for _, fix in fixes]) for name in ("lat_deg", "lon_deg", "alt_m")
    )
    # A stray would tilt the world if it became the origin, and bend the course.
    trusted = trusted_fixes(stamps_ns, lat_deg, lon_deg, alt_m)
    samples.lose_strays(trusted)
    stamps_ns = stamps_ns[trusted]
    lat_deg, lon_deg, alt_m = (values[trusted] for values in (lat_deg, lon_deg, alt_m))
    known_m = alt_m[np.isfinite(alt_m)]
    origin = LocalFrame(float(lat_deg[0]), float(lon_deg[0]), float(known_m[0]) if len(known_m) else 0.0)
    samples.origin = wgs84_origin(origin)
    # Without height, level ground is assumed.
    antennas_m = origin.to_local(lat_deg, lon_deg, np.where(np.isnan(alt_m), origin.alt_m, alt_m))

    ego = rig.ego_frame
    if source.imu:
        imu_SE3_ego = SE3()
        if turns:
            imu_SE3_ego = mounted(frames, turns[0][1].frame_id, ego, "Imu", samples)
        enu_Q_imu, valid = _orientations(source, turns, stamps_ns)
        local_Q_imu = origin.rotations_to_local(lat_deg, lon_deg, enu_Q_imu)
        rotations = quaternion_multiply(local_Q_imu, np.array(imu_SE3_ego.rotation))
    else:
        rotations, valid = _courses(antennas_m), np.ones(len(stamps_ns), np.bool_)
    antenna_SE3_ego = mounted(frames, fixes[0][1].frame_id, ego, "antenna", samples)
    # The fix is the position of the antenna, which has no orientation of its own.
    ego_antenna_m = np.array(antenna_SE3_ego.inverse().translation)
    positions = antennas_m - rotate(rotations, ego_antenna_m)
    samples.add_mounted([int(stamp) for stamp in stamps_ns[valid]], positions[valid], rotations[valid], SE3())
    missing = len(stamps_ns) - int(valid.sum())
    if missing:
        samples.counts.lose("no Imu orientation at its time", missing)
    return samples


def _orientations(
    source: NavSatSource, turns: list[tuple[int, ImuReading]], stamps_ns: NDArray[np.int64]
) -> tuple[Floats, NDArray[np.bool_]]:
    """Return (N, 4) Imu orientations interpolated at the stamps of the fixes, and (N,) whether there is one."""
    by_stamp: dict[int, tuple[float, float, float, float]] = {}
    for stamp_ns, reading in turns:
        by_stamp.setdefault(stamp_ns, reading.enu_Q_imu)
    in_order = sorted(by_stamp)
    track = Trajectory(
        np.array(in_order, dtype=np.int64),
        np.zeros((len(in_order), 3)),
        np.array([by_stamp[stamp] for stamp in in_order]).reshape(-1, 4),
        round(source.max_gap_s * 1e9),
        round(source.extrapolate_s * 1e9),
    )
    _, rotations, valid = track.at(stamps_ns)
    return rotations, valid


def _courses(positions_m: Floats) -> Floats:
    """Return (N, 4) headings along (N, 3) positions.

    At a position with distance to those before and after, it is the tangent of the circle through
    the three; while the vehicle stands, the last heading holds. Reversing cannot be recognized.
    """
    anchors = [0]
    for i in range(1, len(positions_m)):
        east, north = (positions_m[i, :2] - positions_m[anchors[-1], :2]).tolist()
        if sqrt(east * east + north * north) >= LEAST_STEP_M:
            anchors.append(i)
    if len(anchors) == 1:
        return np.tile(IDENTITY_QUATERNION, (len(positions_m), 1))
    steps = positions_m[anchors[1:]] - positions_m[anchors[:-1]]
    sine, cosine = sin_cos(arctan2(steps[:, 1], steps[:, 0]) / 2)
    chords = np.stack([cosine, np.zeros_like(sine), np.zeros_like(sine), sine], axis=-1)
    lengths = np.sqrt(steps[:, 0] ** 2 + steps[:, 1] ** 2)
    tangents = slerp(chords[:-1], chords[1:], lengths[:-1] / (lengths[:-1] + lengths[1:]))
    at_anchors = np.concatenate([chords[:1], tangents, chords[-1:]])
    latest = np.searchsorted(np.array(anchors), np.arange(len(positions_m)), side="right") - 1
    return at_anchors[latest]
