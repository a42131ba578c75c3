"""Visibility of boxes: the visible fraction of an object.

nuScenes bins "the fraction of annotation visible in all 6 images" into v0-40, v40-60, v60-80 and v80-100 (its schema, table
`visibility`); annotators judged it, occlusion included. Here it is computed from the files of the keyframe:

1. In the images: a box is a lattice of 5 x 5 x 5 points from face to face. A point is in an image if it is in front of
   the camera and projects into the image. The result is the share of points that are in at least one image.
2. Not occluded: of the lidar's rays through the core of the box or towards it, the share that do not end in front of it
   (`nuscenes.points`). A return up to 0.3 m in front of the box belongs to the object; farther, if the object moves while
   the lidar turns. With several lidars, the one that sees most of the box counts. A box without rays is judged by the
   images alone.

The visibility is the product of both. A box without a single lidar point is v60-80 at most, because nothing confirms that it
can be seen. Where the keyframe has no image (or none with intrinsics), the lidar decides alone, and a box without lidar
points is v0-40. Without lidar, the images decide alone; with neither, a box with a radar point is v80-100 and any other
v0-40. Levels include their lower bound, but not the upper one.

Projection assumes a pinhole camera, so results are approximate for images that are written without undistortion.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bagassets.formats.nuscenes.points import Hits
from bagassets.formats.nuscenes.tokens import VISIBILITY_LEVELS
from bagassets.geometry.se3 import SE3, Floats, rotate

STEPS = 5
NEAREST_M = 0.1
_AXIS = np.arange(STEPS) / (STEPS - 1) - 0.5
# (125, 3) in units of length (x), width (y), height (z).
_LATTICE = np.stack(np.meshgrid(_AXIS, _AXIS, _AXIS, indexing="ij"), axis=-1).reshape(-1, 3)
_BOUNDS = (0.4, 0.6, 0.8)
# Upper bound for a box without points: the middle of v60-80.
_UNCONFIRMED = 0.7


@dataclass(frozen=True)
class CameraView:
    """One image.

    Attributes:
        global_SE3_camera: pose of the camera when the image was taken; z points forward, y down.
        intrinsic: (3, 3) matrix K of the image as written.
        width: in pixels.
        height: in pixels.
    """

    global_SE3_camera: SE3
    intrinsic: Floats
    width: int
    height: int


def share_in_images(
    views: Sequence[CameraView], centers_m: Floats, rotations: Floats, sizes_m: Floats
) -> Floats:
    """Return the share (B,) of each box that is in the images of a sample.

    Args:
        views: the images, at least one.
        centers_m: (B, 3) box centres in the global frame.
        rotations: (B, 4) `global <- box` quaternions w, x, y, z.
        sizes_m: (B, 3) width, length, height.
    """
    extents = sizes_m[:, [1, 0, 2]]
    offsets = rotate(rotations[:, None, :], _LATTICE[None] * extents[:, None, :])
    points = (centers_m[:, None, :] + offsets).reshape(-1, 3)
    seen = _in_image(views, points).any(axis=0)
    shares: Floats = seen.reshape(len(centers_m), -1).sum(axis=1) / len(_LATTICE)
    return shares


def share_open(hits: Sequence[Hits], number: int) -> Floats:
    """Return the share (B,) of rays to each box that are not blocked; NaN for boxes without rays.

    Args:
        hits: the hits of each lidar of a sample.
        number: number of boxes.
    """
    shares = np.full(number, np.nan)
    for one in hits:
        asked = one.rays > 0
        own = np.where(asked, 1.0 - one.blocked / np.maximum(one.rays, 1), np.nan)
        shares = np.fmax(shares, own)
    return shares


def visibility_levels(
    in_images: Floats | None, is_open: Floats | None, points: NDArray[np.int64]
) -> list[str]:
    """Return the visibility level of each of (B,) boxes.

    Args:
        in_images: (B,) shares in the images; None without images.
        is_open: (B,) shares of rays that are not blocked, NaN without rays; None without a lidar.
        points: (B,) number of lidar points in each box; of radar points without a lidar.
    """
    shares = np.ones(len(points)) if in_images is None else in_images
    if is_open is not None:
        shares = shares * np.where(np.isnan(is_open), 1.0, is_open)
    if in_images is None:
        shares = np.where(points > 0, shares, 0.0)
    elif is_open is not None:
        shares = np.where(points > 0, shares, np.minimum(shares, _UNCONFIRMED))
    return [VISIBILITY_LEVELS[sum(share >= bound for bound in _BOUNDS)] for share in shares.tolist()]


def _in_image(views: Sequence[CameraView], points_global: Floats) -> NDArray[np.bool_]:
    """Tell (V, N) which of (N, 3) points are in front of each camera and inside its image."""
    poses = [view.global_SE3_camera.inverse() for view in views]
    rotations = np.array([pose.rotation for pose in poses])[:, None, :]
    translations = np.array([pose.translation for pose in poses])[:, None, :]
    x, y, z = np.moveaxis(rotate(rotations, points_global[None]) + translations, -1, 0)
    k = np.array([view.intrinsic for view in views])[:, :, :, None]
    sizes = np.array([(view.width, view.height) for view in views])
    width, height = sizes[:, 0, None], sizes[:, 1, None]
    front = z > NEAREST_M
    depth = np.where(front, z, 1.0)
    u = (k[:, 0, 0] * x + k[:, 0, 1] * y) / depth + k[:, 0, 2]
    v = k[:, 1, 1] * y / depth + k[:, 1, 2]
    inside: NDArray[np.bool_] = front & (u >= 0) & (u < width) & (v >= 0) & (v < height)
    return inside
