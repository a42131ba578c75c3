"""Roll, pitch and yaw: turns about the fixed axes x, then y, then z (REP 103)."""

from collections.abc import Iterable

import numpy as np

from bagassets.geometry.portable import sin_cos
from bagassets.geometry.se3 import Floats, Number


def quaternions_from_rpy(rpy_rad: Floats) -> Floats:
    """Return (..., 4) quaternions w, x, y, z of (..., 3) roll, pitch and yaw in radians."""
    sines, cosines = sin_cos(rpy_rad / 2)
    return np.stack(of_half_angles(np.moveaxis(sines, -1, 0), np.moveaxis(cosines, -1, 0)), axis=-1)


def of_half_angles(
    sines: Iterable[Number], cosines: Iterable[Number]
) -> tuple[Number, Number, Number, Number]:
    """Return the quaternion w, x, y, z of half the roll, pitch and yaw, given as sines and cosines."""
    (sr, sp, sy), (cr, cp, cy) = sines, cosines
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )
