"""Poses relative to the first one, as position and roll, pitch, yaw."""

from math import pi

import numpy as np

from bagassets.geometry.portable import arctan2
from bagassets.geometry.se3 import Floats, quaternion_multiply, rotate

__all__ = ["relative_poses", "roll_pitch_yaw"]

METRE_DIGITS = 6
RADIAN_DIGITS = 9
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
        [round(float(v), METRE_DIGITS) + 0.0 for v in offset_m]
        + [round(float(v), RADIAN_DIGITS) + 0.0 for v in angle]
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
