"""How many points lie inside boxes."""

import numpy as np
from numpy.typing import NDArray

from bagassets.geometry.se3 import SE3, Floats, rotate

__all__ = ["count_points"]

# What float32 and the way there and back may move a point by.
ROUNDING_M = 1e-3


def count_points(
    points: NDArray[np.float32], global_SE3_sensor: SE3, centers_m: Floats, rotations: Floats, sizes_m: Floats
) -> NDArray[np.int64]:
    """Count the points inside each box; one on the surface is inside.

    Args:
        points: (N, 3) in the sensor frame; NaN is inside no box.
        global_SE3_sensor: where the sensor was.
        centers_m: (B, 3) box centres in the global frame.
        rotations: (B, 4) `global <- box` quaternions.
        sizes_m: (B, 3) width, length, height.

    Returns:
        (B,) counts.
    """
    sensor_SE3_global = global_SE3_sensor.inverse()
    centers = sensor_SE3_global.transform_points(centers_m)
    counts = np.zeros(len(centers_m), dtype=np.int64)
    # Sorted along x, each box has few candidates: revolutions hold 10^5 points, scenes 10^2 boxes.
    ordered = points[np.argsort(points[:, 0])]
    radii = np.sqrt((sizes_m * sizes_m).sum(axis=1)) / 2 + ROUNDING_M
    lows = np.searchsorted(ordered[:, 0], centers[:, 0] - radii, side="left")
    highs = np.searchsorted(ordered[:, 0], centers[:, 0] + radii, side="right")
    for box in range(len(centers_m)):
        near = ordered[lows[box] : highs[box]].astype(np.float64)
        near = near[np.abs(near[:, 1] - centers[box, 1]) <= radii[box]]
        if not len(near):
            continue
        away_global = global_SE3_sensor.transform_points(near) - centers_m[box]
        w, x, y, z = rotations[box]
        away_box = np.abs(rotate(np.array([w, -x, -y, -z]), away_global))
        width, length, height = sizes_m[box] / 2
        inside = (away_box[:, 0] <= length) & (away_box[:, 1] <= width) & (away_box[:, 2] <= height)
        counts[box] = int(np.count_nonzero(inside))
    return counts
