"""How many points of a lidar or radar file lie inside boxes."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bagassets.errors import DatasetError
from bagassets.geometry.se3 import SE3, Floats, rotate

__all__ = ["count_points", "read_lidar_xyz", "read_radar_xyz"]

LIDAR_COLUMNS = 5
_PCD_TYPES = {("F", 4): "<f4", ("F", 8): "<f8", ("I", 1): "<i1", ("I", 2): "<i2", ("I", 4): "<i4",
              ("U", 1): "<u1", ("U", 2): "<u2", ("U", 4): "<u4"}  # fmt: skip


def read_lidar_xyz(path: Path) -> NDArray[np.float32]:
    """Return the (N, 3) points of a `.pcd.bin` file, metres in the sensor frame."""
    values = np.fromfile(path, dtype="<f4")
    if len(values) % LIDAR_COLUMNS:
        raise DatasetError(
            f"{path}: {values.nbytes} bytes are no whole number of points; the artifact is damaged, build again."
        )
    return values.reshape(-1, LIDAR_COLUMNS)[:, :3]


def read_radar_xyz(path: Path) -> NDArray[np.float32]:
    """Return the (N, 3) targets of a binary `.pcd` file, metres in the sensor frame.

    A file without targets holds one of NaN, as nuScenes has it; it is inside no box.
    """
    data = path.read_bytes()
    head, found, body = data.partition(b"DATA binary\n")
    header = {
        line.split(" ", 1)[0]: line.split(" ")[1:] for line in head.decode("ascii", "replace").splitlines()
    }
    try:
        columns = zip(header["FIELDS"], header["TYPE"], header["SIZE"], strict=True)
        dtype = np.dtype([(name, _PCD_TYPES[kind, int(size)]) for name, kind, size in columns])
        targets = np.frombuffer(body, dtype, count=int(header["POINTS"][0]))
        xyz = np.stack([targets[axis] for axis in "xyz"], axis=1)
    except (KeyError, ValueError) as err:
        raise DatasetError(
            f"{path}: not a binary radar file ({err}); the artifact is damaged, build again."
        ) from err
    if not found:
        raise DatasetError(f"{path}: not a binary radar file; the artifact is damaged, build again.")
    return xyz.astype(np.float32)


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
    # Along x and y sorted slices leave few candidates: revolutions hold 10^5 points, scenes 10^2 boxes.
    order = np.argsort(points[:, 0], kind="stable")
    ordered = points[order].astype(np.float64)
    radii = np.sqrt((sizes_m * sizes_m).sum(axis=1)) / 2
    lows = np.searchsorted(ordered[:, 0], centers[:, 0] - radii, side="left")
    highs = np.searchsorted(ordered[:, 0], centers[:, 0] + radii, side="right")
    for box in range(len(centers_m)):
        near = ordered[lows[box] : highs[box]]
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
