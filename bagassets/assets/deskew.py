"""Removing the distortion that the sensor's own motion puts into a revolution.

Each point is moved from where the sensor saw it to where the sensor would see it at the stamp:

    p(stamp) = inverse(global_SE3_sensor(stamp)) * global_SE3_sensor(t) * p(t)

The combined transform is computed at knots one millisecond apart and interpolated linearly,
entry by entry, in between. That is exact for uniform motion; at 1 rad/s a point 100 m away is
0.01 mm off, and where the trajectory has a kink (the velocity jumps by 1 m/s at a pose) at most
0.3 mm.
"""

import numpy as np
from numpy.typing import NDArray

from bagassets.geometry.kernels.moving import KNOT_NS, move_points
from bagassets.geometry.se3 import SE3, Floats, quaternion_multiply, rotate
from bagassets.geometry.trajectory import Trajectory

__all__ = ["deskew"]


def deskew(
    points: NDArray[np.float32],
    times_ns: NDArray[np.int64],
    stamp_ns: int,
    trajectory: Trajectory,
    ego_SE3_sensor: SE3,
) -> bool:
    """Move points to where the sensor would see them from where it was at `stamp_ns`.

    Args:
        points: (N, 5) float32, x, y, z in the sensor frame when each was measured; changed in place.
        times_ns: (N,) when each was measured.
        stamp_ns: time to move them to.
        trajectory: poses of the ego frame.
        ego_SE3_sensor: where the sensor is mounted.

    Returns:
        False, with the points as they were, if there is no ego pose at the stamp, or at a time in between.
    """
    if not len(points):
        return True
    first = min(int(times_ns.min()), stamp_ns)
    last = max(int(times_ns.max()), stamp_ns)
    knots_ns = np.arange((last - first) // KNOT_NS + 2, dtype=np.int64) * KNOT_NS + first
    knots_ns[-1] = last  # poses may end there
    transforms = _sensor_motion(knots_ns, stamp_ns, trajectory, ego_SE3_sensor)
    if transforms is None:
        return False
    move_points(points, times_ns, knots_ns, transforms)
    return True


def _sensor_motion(
    times_ns: NDArray[np.int64], stamp_ns: int, trajectory: Trajectory, ego_SE3_sensor: SE3
) -> Floats | None:
    """Return (M, 12) rows of the 3x4 matrices `sensor(stamp)_SE3_sensor(t)`, None without a pose."""
    positions, rotations, valid = trajectory.at(np.append(times_ns, np.int64(stamp_ns)))
    if not valid.all():
        return None
    # global_SE3_sensor = global_SE3_ego * ego_SE3_sensor, for all times
    translations = positions + rotate(rotations, np.array(ego_SE3_sensor.translation)[None, :])
    rotations = quaternion_multiply(rotations, np.array(ego_SE3_sensor.rotation)[None, :])
    back = rotations[-1] * np.array([1.0, -1.0, -1.0, -1.0])
    moved_m = rotate(back[None, :], translations[:-1] - translations[-1])
    w, x, y, z = np.moveaxis(quaternion_multiply(back[None, :], rotations[:-1]), -1, 0)
    return np.stack(
        [
            1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), moved_m[:, 0],
            2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x), moved_m[:, 1],
            2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y), moved_m[:, 2],
        ],
        axis=1,
    )  # fmt: skip
