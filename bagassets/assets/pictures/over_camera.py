"""Pictures drawn into a camera image: lidar points, coloured by distance, and the future trajectory.

Wrong calibration is obvious in the one; the other shows poses, extrinsics and intrinsics at once.
"""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from bagassets.assets.pictures.canvas import ACCENT, TEXT, Image, scaled_to, text, text_width, turbo
from bagassets.assets.pictures.channels import View
from bagassets.geometry.se3 import Floats, rotate

MOST_POINTS = 40_000
SPARSE_POINTS = 8_000  # fewer are drawn larger
NEAR_M, FAR_M = 3.0, 60.0
_MARKS_M = (3, 5, 10, 20, 60)
_DARKEST = 0.12
HALF_TRACK_M = 0.9
_OPACITY = 0.45
# Of band and picture; in single precision, rounded once, as where the processor multiplies and adds in one step. Elsewhere
# `cv2.addWeighted` rounds twice.
_REST = (np.float32(1 - _OPACITY) * np.arange(256, dtype=np.float32)).astype(np.float64)
_SUMS = float(np.float32(_OPACITY)) * np.arange(256.0)[:, np.newaxis] + _REST
_MIXED = np.rint(_SUMS.astype(np.float32)).astype(np.uint8)


def lidar_over_camera(
    image: Image, points_global: Floats, view: View, *, width: int = 1280, title: str = ""
) -> Image:
    """Draw the points in the camera's view into its image.

    Args:
        image: (H, W, 3) BGR, as written.
        points_global: (N, 3) lidar points in the global frame, metres.
        view: pose and model of the camera when the image was taken.
        width: of the picture in pixels.
        title: text in the corner.
    """
    picture = scaled_to(image, width).copy()
    scale = picture.shape[1] / image.shape[1]
    pixels, depth, seen = view.project(points_global, scale)
    shown = np.flatnonzero(seen)
    shown = shown[:: 1 + len(shown) // MOST_POINTS]
    shown = shown[np.argsort(-depth[shown], kind="stable")]  # near points cover far ones
    radius = max(1, round(width / (900 if len(shown) > SPARSE_POINTS else 500)))
    _dots(picture, np.rint(pixels[shown]).astype(np.int32), _colours(_share(depth[shown])), radius)
    _legend(picture)
    text(picture, title, 12, 24, size_px=max(11, width / 80), halo=True)
    return picture


def _dots(picture: Image, pixels: NDArray[np.int32], colours: NDArray[np.uint8], radius: int) -> None:
    """Draw dots in order; those of one colour that follow each other together.

    To OpenCV a closed line of a single point is a dot as wide as the line. Forty thousand circles take three times as long, and
    so do dots with smooth edges.
    """
    begins = np.flatnonzero((np.diff(colours.astype(np.int16), axis=0, prepend=-1) != 0).any(axis=1))
    for same in np.split(np.arange(len(pixels)), begins[1:]):
        if len(same):
            # An array of lines; OpenCV's types know only lists, which take longer.
            lines: Any = pixels[same, None]
            cv2.polylines(picture, lines, True, colours[same[0]].tolist(), 2 * radius, cv2.LINE_8)


def _share(depth_m: Floats) -> Floats:
    """Return the place of distances between near (1, red) and far (0, blue): the root of their inverse, scaled.

    Nearly a logarithm, but made of operations that every processor rounds alike.
    """
    inverse = 1.0 / np.clip(depth_m, NEAR_M, FAR_M)
    return np.sqrt((inverse - 1.0 / FAR_M) / (1.0 / NEAR_M - 1.0 / FAR_M))


def _colours(shares: Floats) -> NDArray[np.uint8]:
    """Return the colours of shares; the scale begins at a blue that stands out from a dark image."""
    return turbo(_DARKEST + (1.0 - _DARKEST) * shares)


def _legend(picture: Image) -> None:
    height, width = picture.shape[:2]
    length, thickness = width // 4, max(6, height // 80)
    left, top = width - length - 16, height - thickness - 12
    bar = _colours(np.linspace(1.0, 0.0, length)).reshape(1, length, 3)
    cv2.rectangle(picture, (left - 8, top - 26), (width - 6, height - 5), (0, 0, 0), -1)
    picture[top : top + thickness, left : left + length] = bar
    for mark in _MARKS_M:
        x = left + (1.0 - float(_share(np.array([float(mark)]))[0])) * (length - 1)
        words = f"{mark} m" if mark == _MARKS_M[-1] else str(mark)
        text(picture, words, min(x - 8, width - 10 - text_width(words, 10)), top - 6, size_px=10, colour=TEXT)


def future_trajectory(
    image: Image,
    positions_global: Floats,
    rotations: Floats,
    seconds: Floats,
    view: View,
    *,
    width: int = 1280,
    title: str = "",
) -> Image:
    """Draw the band that the vehicle will drive over, as wide as a car, with a mark for each second.

    It lies at the height of the ego frame's origin, which is on the ground in most vehicles (REP 105).

    Args:
        image: (H, W, 3) BGR, as written.
        positions_global: (P, 3) of the ego frame from the moment of the image on.
        rotations: (P, 4) of the ego frame.
        seconds: (P,) time of each since the image.
        view: pose and model of the camera when the image was taken.
        width: of the picture in pixels.
        title: text in the corner.
    """
    picture = scaled_to(image, width).copy()
    scale = picture.shape[1] / image.shape[1]
    sides = [
        view.project(positions_global + rotate(rotations, np.array([0.0, side, 0.0])), scale)
        for side in (HALF_TRACK_M, -HALF_TRACK_M)
    ]
    (left, depth, left_seen), (right, _, right_seen) = sides
    band = picture.copy()
    # The band ends where one of its edges leaves the image.
    drawn = left_seen & right_seen & (depth > 0)
    for i in np.flatnonzero(drawn[:-1] & drawn[1:]).tolist():
        corners = np.array([left[i], left[i + 1], right[i + 1], right[i]])
        cv2.fillConvexPoly(band, np.rint(corners * 16).astype(np.int32), ACCENT, cv2.LINE_AA, 4)
    picture = _MIXED[band, picture]
    for second in range(1, int(seconds[-1]) + 1 if len(seconds) else 1):
        i = int(np.searchsorted(seconds, second))
        if i < len(seconds) and drawn[i]:
            a, b = (tuple(np.rint(side[i]).astype(int).tolist()) for side in (left, right))
            cv2.line(picture, a, b, TEXT, max(1, width // 900), cv2.LINE_AA)
            text(picture, f"{second} s", b[0] + 6, b[1] + 4, size_px=max(10, width / 100), halo=True)
    text(picture, title, 12, 24, size_px=max(11, width / 80), halo=True)
    return picture
