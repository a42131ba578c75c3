"""Roll, pitch and yaw: turns about the fixed axes x, then y, then z (REP 103)."""

import numpy as np

from bagassets.geometry.portable import sin_cos
from bagassets.geometry.se3 import Floats

__all__ = ["quaternions_from_rpy"]


def quaternions_from_rpy(rpy_rad: Floats) -> Floats:
    """Return (..., 4) quaternions w, x, y, z of (..., 3) roll, pitch and yaw in radians."""
    sines, cosines = sin_cos(rpy_rad / 2)
    sr, sp, sy = np.moveaxis(sines, -1, 0)
    cr, cp, cy = np.moveaxis(cosines, -1, 0)
    return np.stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ],
        axis=-1,
    )
