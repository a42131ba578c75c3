"""Trajectories of one frame in another, as tables for CSV and Parquet; poses relative to the first one, as position and angles."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import isnan, pi

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from bagassets.base.errors import CalibrationError
from bagassets.base.json_types import JsonMapping
from bagassets.formats.json_files import rounded
from bagassets.geometry.calibration import Mounts
from bagassets.geometry.portable import arctan2
from bagassets.geometry.se3 import SE3, Floats, quaternion_multiply, rotate
from bagassets.geometry.tf_tree import TfTree
from bagassets.geometry.trajectory import Trajectory
from bagassets.geometry.wgs84 import LocalFrame, utm_track

_RADIAN_DIGITS = 9
_CONJUGATE = np.array([1.0, -1.0, -1.0, -1.0])
# Closer to the zenith, roll and yaw are the same rotation; all of it is called yaw.
_GIMBAL_LOCK = 1.0 - 1e-12


def relative_poses(positions_m: Floats, rotations: Floats) -> list[list[float]]:
    """Return `first_SE3_i` of each pose as x, y, z (metres) and roll, pitch, yaw (radians).

    The transforms are composed, `first_SE3_i = (global_SE3_first)^-1 global_SE3_i`, and the angles are those of the
    result: the difference between the angles of two poses is not the rotation between them.

    Args:
        positions_m: (N, 3) of `global_SE3_i`.
        rotations: (N, 4) unit quaternions w, x, y, z.
    """
    first_Q_global = rotations[0] * _CONJUGATE
    offsets_m = rotate(first_Q_global, positions_m - positions_m[0])
    angles = roll_pitch_yaw(quaternion_multiply(first_Q_global, rotations))
    return [
        rounded(offset_m) + rounded(angle, _RADIAN_DIGITS)
        for offset_m, angle in zip(offsets_m, angles, strict=True)
    ]


def roll_pitch_yaw(rotations: Floats) -> Floats:
    """Return the (N, 3) angles in radians of (N, 4) unit quaternions w, x, y, z.

    They rotate by roll about x, then pitch about y, then yaw about z, all fixed axes (REP 103):
    `R = Rz(yaw) Ry(pitch) Rx(roll)`. At a pitch of ±90 degrees roll is set to 0.
    """
    w, x, y, z = np.moveaxis(rotations, -1, 0)
    sine = np.clip(2 * (w * y - z * x), -1.0, 1.0)
    pitch = arctan2(sine, np.sqrt(1.0 - sine * sine))
    locked = np.abs(sine) > _GIMBAL_LOCK
    roll = np.where(locked, 0.0, arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)))
    yaw = np.where(
        locked,
        arctan2(2 * (w * z - x * y), 1 - 2 * (x * x + z * z)),
        arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
    )
    wrapped = np.where(yaw <= -pi, yaw + 2 * pi, yaw)
    return np.stack([roll, pitch, wrapped], axis=-1)


# Decimal places: a micrometre, 1e-9 for quaternions and radians, a tenth of a millimetre of latitude, and the tenth of a
# millimetre that UTM is accurate to.
_DIGITS = {"x": 6, "y": 6, "z": 6, "qw": 9, "qx": 9, "qy": 9, "qz": 9, "roll": 9, "pitch": 9, "yaw": 9,
           "lat": 9, "lon": 9, "alt": 4, "easting": 4, "northing": 4}  # fmt: skip


@dataclass(frozen=True, eq=False)
class TimedPoses:
    """`reference_SE3_sensor` at (N,) stamps.

    Attributes:
        stamps_ns: (N,) increasing.
        positions_m: (N, 3).
        rotations: (N, 4) w, x, y, z.
        in_global: the reference is the global frame of the ego poses.
    """

    stamps_ns: NDArray[np.int64]
    positions_m: Floats
    rotations: Floats
    in_global: bool = False


@dataclass(frozen=True)
class Bodies:
    """Frames whose poses do not need TF: those fixed to the vehicle, and the global frame.

    Attributes:
        ego_SE3: name (channel, sensor frame, `ego`, ego frame) -> `ego_SE3_<name>`.
        global_names: names of the global frame.
        ego_frame: its name in TF.
        global_frame: its name in TF.
    """

    ego_SE3: Mapping[str, SE3]
    global_names: frozenset[str]
    ego_frame: str
    global_frame: str

    @classmethod
    def of(cls, mounts: Mounts, global_frame: str) -> "Bodies":
        """Return the frames of sensors and of ego poses in `global_frame`."""
        ego_SE3 = {"ego": SE3(), mounts.ego_frame: SE3()}
        for name, mount in sorted(mounts.channels.items()):
            ego_SE3_sensor = mount.ego_SE3_sensor.normalised()
            ego_SE3[name] = ego_SE3_sensor
            if mount.frame:
                ego_SE3.setdefault(mount.frame, ego_SE3_sensor)
        names = frozenset({"global", global_frame}) - ego_SE3.keys()
        return cls(ego_SE3, names, mounts.ego_frame, global_frame)

    def in_tf(self, frame: str) -> tuple[str, SE3]:
        """Return the TF frame that a frame is fixed to, and `tf_SE3_frame`.

        Frames on the vehicle are fixed to the ego frame, because extrinsics in the recipe are not in TF.
        """
        if frame in self.global_names:
            return self.global_frame, SE3()
        return (self.ego_frame, self.ego_SE3[frame]) if frame in self.ego_SE3 else (frame, SE3())

    def has(self, *frames: str) -> bool:
        """Tell whether the poses of all these frames are known without TF."""
        return all(frame in self.ego_SE3 or frame in self.global_names for frame in frames)

    def poses(self, sensor: str, reference: str, trajectory: Trajectory) -> TimedPoses:
        """Return `reference_SE3_sensor` at the stamps of the ego poses, or a single pose if it never changes."""
        t, q = trajectory.positions_m, trajectory.rotations
        stamps_ns = trajectory.stamps_ns
        if (sensor in self.global_names) == (reference in self.global_names):
            t, q = np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0, 0.0]])
            stamps_ns = stamps_ns[:1] if len(stamps_ns) else np.zeros(1, dtype=np.int64)
            if sensor in self.ego_SE3:
                fixed = self.ego_SE3[reference].inverse() @ self.ego_SE3[sensor]
                t, q = np.array([fixed.translation]), np.array([fixed.rotation])
            return TimedPoses(stamps_ns, t, q, reference in self.global_names)
        body = reference if sensor in self.global_names else sensor
        ego_SE3_body = self.ego_SE3[body]
        t = rotate(q, np.array(ego_SE3_body.translation)) + t
        q = quaternion_multiply(q, np.array(ego_SE3_body.rotation))
        if sensor in self.global_names:
            q = q * _CONJUGATE
            t = -rotate(q, t)
        return TimedPoses(stamps_ns, t, q, reference in self.global_names)


def tf_poses(sensor: str, reference: str, bodies: Bodies, tree: TfTree, max_gap_ns: int) -> TimedPoses:
    """Return `reference_SE3_sensor` from TF, at every stamp of a transform between the two.

    Raises:
        CalibrationError: the frames are not connected.
    """
    (src, src_SE3_sensor), (dst, dst_SE3_reference) = bodies.in_tf(sensor), bodies.in_tf(reference)
    poses = _between(dst, src, tree, max_gap_ns)
    positions = rotate(poses.rotations, np.array(src_SE3_sensor.translation)) + poses.positions_m
    rotations = quaternion_multiply(poses.rotations, np.array(src_SE3_sensor.rotation))
    reference_SE3_dst = dst_SE3_reference.inverse()
    return TimedPoses(
        poses.stamps_ns,
        reference_SE3_dst.transform_points(positions),
        quaternion_multiply(np.array(reference_SE3_dst.rotation), rotations),
    )


def _between(reference: str, sensor: str, tree: TfTree, max_gap_ns: int) -> TimedPoses:
    """Return `reference_SE3_sensor` for two frames in TF."""
    up, down = tree.chain(reference, sensor)
    moving = [edge.stamps_ns for edge in (*up, *down) if edge.moves]
    if not moving:
        fixed, _ = tree.fixed(reference, sensor)
        return TimedPoses(
            np.zeros(1, dtype=np.int64), np.array([fixed.translation]), np.array([fixed.rotation])
        )
    stamps_ns = np.unique(np.concatenate(moving))
    positions, rotations, valid = tree.at(reference, sensor, stamps_ns, max_gap_ns, 0)
    if not valid.any():
        raise CalibrationError(
            f"transforms between {sensor} and {reference} never overlap in time (max_gap_s {max_gap_ns / 1e9:g})"
        )
    return TimedPoses(stamps_ns[valid], positions[valid], rotations[valid])


def trajectory_table(poses: TimedPoses, origin: JsonMapping | None) -> pa.Table:
    """Return a table of stamps, positions, quaternions and angles, with positions on Earth where known.

    Args:
        poses: the trajectory.
        origin: `origin` of `ego_poses.json`; used if the reference is the global frame.
    """
    angles = roll_pitch_yaw(poses.rotations)
    columns: dict[str, pa.Array] = {"stamp_ns": pa.array(poses.stamps_ns, pa.int64())}
    numbers = dict(zip(("x", "y", "z"), poses.positions_m.T, strict=True))
    numbers |= dict(zip(("qw", "qx", "qy", "qz"), poses.rotations.T, strict=True))
    numbers |= dict(zip(("roll", "pitch", "yaw"), angles.T, strict=True))
    on_earth = geodetic_columns(poses.positions_m, origin) if poses.in_global and origin else None
    if on_earth is not None:
        numbers |= on_earth[0]
    for name, values in numbers.items():
        known = [None if isnan(value) else value for value in rounded(values, _DIGITS[name])]
        columns[name] = pa.array(known, pa.float64())
    if on_earth is not None:
        columns["utm_zone"] = pa.array(on_earth[1], pa.string())
    return pa.table(columns)


def geodetic_columns(
    positions_m: Floats, origin: JsonMapping
) -> tuple[dict[str, Floats], list[str | None]] | None:
    """Return lat, lon, alt, UTM easting and northing, and UTM zones; None if the place of the origin on Earth is unknown.

    Beyond 80° S and 84° N, where UTM is not defined, easting and northing are NaN and the zone is None.

    Args:
        positions_m: (N, 3) in the global frame.
        origin: `origin` of `ego_poses.json`.
    """
    if origin.get("kind") != "wgs84":
        return None
    frame = LocalFrame(origin["lat"], origin["lon"], origin["alt"])
    lat, lon, alt = frame.to_geodetic(positions_m)
    grid = utm_track(lat, lon)
    numbers = {"lat": lat, "lon": lon, "alt": alt, "easting": grid.easting_m, "northing": grid.northing_m}
    return numbers, grid.zones


def csv_bytes(table: pa.Table) -> bytes:
    """Return a table as CSV: names in the first line, shortest exact numbers, empty for unknown ones."""
    columns = [table.column(name).to_pylist() for name in table.column_names]
    lines = [",".join(table.column_names)]
    lines += [",".join("" if v is None else str(v) for v in row) for row in zip(*columns, strict=True)]
    return ("\n".join(lines) + "\n").encode()
