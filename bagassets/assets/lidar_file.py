"""Lidar files in the layout of nuScenes, `.pcd.bin`: rows of five little-endian float32, no header.

The columns are x, y, z in metres in the sensor frame, intensity (0 to 255 in nuScenes' own files; here
as recorded, see `bagassets.decode.pointcloud2`) and ring (-1 where not recorded).
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bagassets.base.errors import DatasetError

COLUMNS = ("x", "y", "z", "intensity", "ring")


def lidar_bytes(points: NDArray[np.float32]) -> memoryview:
    """Return the content of the file for (N, 5) points.

    Raises:
        ValueError: the points have another shape.
    """
    if points.ndim != 2 or points.shape[1] != len(COLUMNS):
        raise ValueError(f"lidar points have shape (N, {len(COLUMNS)}), got {points.shape}")
    return np.ascontiguousarray(points, dtype="<f4").reshape(-1).view(np.uint8).data


def read_lidar_file(path: Path) -> NDArray[np.float32]:
    """Return the (N, 5) points of a file, mapped into memory.

    Raises:
        DatasetError: its size is not a whole number of points.
    """
    if path.stat().st_size == 0:
        return np.zeros((0, len(COLUMNS)), dtype=np.float32)
    values = np.memmap(path, dtype="<f4", mode="r")
    if values.size % len(COLUMNS):
        raise DatasetError(f"{path}: its size is not that of a .pcd.bin file; build again to replace it.")
    return values.reshape(-1, len(COLUMNS))
