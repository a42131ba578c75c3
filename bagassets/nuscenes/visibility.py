"""Visibility of boxes: which part of a box the cameras of a sample have in their images.

The rule: a box is a lattice of 5 x 5 x 5 points from face to face. A point counts as seen if it
lies in front of a camera and inside its image. The share of points that at least one camera sees
gives the level: v0-40, v40-60, v60-80 (each up to, not including, its upper bound), v80-100.
Occlusion is not part of the rule: nothing in a recording says what hides what. A box that no
camera sees, and every box of a rig without cameras, has v0-40.

Pixels are those of a pinhole, so cameras written without undistortion are judged approximately.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bagassets.geometry.se3 import SE3, Floats, rotate
from bagassets.nuscenes.tokens import VISIBILITY_LEVELS

__all__ = ["CameraView", "visibility_levels"]

STEPS = 5
NEAREST_M = 0.1
_AXIS = np.arange(STEPS) / (STEPS - 1) - 0.5
# (125, 3) in units of length (x), width (y), height (z).
_LATTICE = np.stack(np.meshgrid(_AXIS, _AXIS, _AXIS, indexing="ij"), axis=-1).reshape(-1, 3)
_BOUNDS = (0.4, 0.6, 0.8)


@dataclass(frozen=True)
class CameraView:
    """One image.

    Attributes:
        global_SE3_camera: where the camera was when it was taken; z points forward, y down.
        intrinsic: (3, 3) matrix K of the image as written.
        width: in pixels.
        height: in pixels.
    """

    global_SE3_camera: SE3
    intrinsic: Floats
    width: int
    height: int

    def sees(self, points_global: Floats) -> np.ndarray:
        """Tell which of (N, 3) points are in front of the camera and inside its image."""
        x, y, z = np.moveaxis(self.global_SE3_camera.inverse().transform_points(points_global), -1, 0)
        (fx, skew, cx), (_, fy, cy) = self.intrinsic[0], self.intrinsic[1]
        front = z > NEAREST_M
        depth = np.where(front, z, 1.0)
        u = (fx * x + skew * y) / depth + cx
        v = fy * y / depth + cy
        seen: np.ndarray = front & (u >= 0) & (u < self.width) & (v >= 0) & (v < self.height)
        return seen


def visibility_levels(
    views: Sequence[CameraView], centers_m: Floats, rotations: Floats, sizes_m: Floats
) -> list[str]:
    """Return the visibility level of each of (B,) boxes in the global frame.

    Args:
        views: the images of one sample.
        centers_m: (B, 3) box centres.
        rotations: (B, 4) `global <- box` quaternions w, x, y, z.
        sizes_m: (B, 3) width, length, height.
    """
    extents = sizes_m[:, [1, 0, 2]]
    offsets = rotate(rotations[:, None, :], _LATTICE[None] * extents[:, None, :])
    points = (centers_m[:, None, :] + offsets).reshape(-1, 3)
    seen = np.zeros(len(points), dtype=np.bool_)
    for view in views:
        seen |= view.sees(points)
    shares = seen.reshape(len(centers_m), -1).sum(axis=1) / len(_LATTICE)
    return [VISIBILITY_LEVELS[sum(share >= bound for bound in _BOUNDS)] for share in shares.tolist()]
