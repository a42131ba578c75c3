"""The bird's-eye view: points, boxes and the trajectory so far, with the vehicle in the middle heading up."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from bagassets.assets.pictures.canvas import ACCENT, DIM, FAINT, Image, blank, colour_of, text, turbo
from bagassets.geometry.se3 import SE3, Floats

# Up to a range, the distance between rings.
_RINGS_M = ((5, 1), (10, 2), (20, 5), (60, 10), (float("inf"), 50))
_CAR_M, _MOST_SHARE = 2.2, 0.09
LOW_M, HIGH_M = -0.5, 3.5
_SHIFT = 4  # bits of sub-pixel position that OpenCV takes


@dataclass(frozen=True)
class BoxAt:
    """A box at the moment of the picture.

    Attributes:
        category: determines the colour.
        global_SE3_box: its pose; x points forward.
        width_m: across.
        length_m: along.
    """

    category: str
    global_SE3_box: SE3
    width_m: float
    length_m: float


def birds_eye(
    points_global: Floats,
    boxes: Sequence[BoxAt],
    past_global: Floats,
    global_SE3_ego: SE3,
    *,
    range_m: float,
    width: int,
    title: str = "",
) -> Image:
    """Draw the surroundings of the vehicle.

    Args:
        points_global: (N, 3) lidar points, metres.
        boxes: boxes at this moment.
        past_global: (P, 3) positions of the vehicle up to this moment.
        global_SE3_ego: the vehicle at this moment.
        range_m: half the side of the view.
        width: of the square picture in pixels.
        title: text in the corner.
    """
    picture = blank(width, width)
    ground = _Ground(global_SE3_ego.inverse(), width / (2 * range_m), width / 2)
    _rings(picture, ground, range_m)
    _points(picture, ground, points_global)
    if len(past_global) > 1:
        cv2.polylines(picture, [ground.pixels(past_global, _SHIFT)], False, ACCENT, 2, cv2.LINE_AA, _SHIFT)
    categories = sorted({box.category for box in boxes})
    for box in boxes:
        _box(picture, ground, box, colour_of(categories.index(box.category)))
    _vehicle(picture, min(_CAR_M, _MOST_SHARE * range_m) * width / (2 * range_m))
    for number, category in enumerate(categories):
        text(picture, category, 12, 46 + 16 * number, size_px=11, colour=colour_of(number), halo=True)
    text(picture, title, 12, 24, size_px=13, halo=True)
    return picture


@dataclass(frozen=True)
class _Ground:
    """Maps the global frame to pixels: x (forward) up, y (left) left."""

    ego_SE3_global: SE3
    pixels_per_m: float
    middle_px: float

    def pixels(self, points_global: Floats, shift: int = 0) -> np.ndarray:
        """Return (N, 2) whole pixels, times two to the power of `shift`."""
        return self.pixels_of(self.ego_SE3_global.transform_points(points_global), shift)

    def pixels_of(self, points_ego: Floats, shift: int = 0) -> np.ndarray:
        """Return the pixels of points in the ego frame; see `pixels`."""
        u = self.middle_px - points_ego[:, 1] * self.pixels_per_m
        v = self.middle_px - points_ego[:, 0] * self.pixels_per_m
        # Far outside the picture, OpenCV's integers would overflow.
        limited = np.clip(np.stack([u, v], axis=1), -1e5, 1e5)
        return np.rint(limited * (1 << shift)).astype(np.int32)


def _rings(picture: Image, ground: _Ground, range_m: float) -> None:
    middle = round(ground.middle_px)
    step_m = next(step_m for most_m, step_m in _RINGS_M if range_m <= most_m)
    for ring in range(1, int(range_m // step_m) + 1):
        radius = round(ring * step_m * ground.pixels_per_m)
        cv2.circle(picture, (middle, middle), radius, FAINT, 1, cv2.LINE_AA)
        text(picture, f"{ring * step_m} m", middle + 4, middle - radius + 12, size_px=9, colour=DIM)
    cv2.line(picture, (middle, 0), (middle, picture.shape[0]), FAINT, 1)
    cv2.line(picture, (0, middle), (picture.shape[1], middle), FAINT, 1)


def _points(picture: Image, ground: _Ground, points_global: Floats) -> None:
    points_ego = ground.ego_SE3_global.transform_points(points_global)
    pixels, height_m = ground.pixels_of(points_ego), points_ego[:, 2]
    size = picture.shape[0]
    inside = ((pixels >= 0) & (pixels < size)).all(axis=1)
    order = np.flatnonzero(inside)[np.argsort(height_m[inside], kind="stable")]  # high points cover low ones
    colours = turbo(0.15 + 0.8 * (np.clip(height_m[order], LOW_M, HIGH_M) - LOW_M) / (HIGH_M - LOW_M))
    picture[pixels[order, 1], pixels[order, 0]] = colours


def _box(picture: Image, ground: _Ground, box: BoxAt, colour: tuple[int, int, int]) -> None:
    x, y = box.length_m / 2, box.width_m / 2
    outline = np.array([[x, y, 0.0], [x, -y, 0.0], [-x, -y, 0.0], [-x, y, 0.0]])
    heading = np.array([[0.0, 0.0, 0.0], [x, 0.0, 0.0]])
    place = box.global_SE3_box.transform_points
    cv2.polylines(picture, [ground.pixels(place(outline), _SHIFT)], True, colour, 2, cv2.LINE_AA, _SHIFT)
    cv2.polylines(picture, [ground.pixels(place(heading), _SHIFT)], False, colour, 1, cv2.LINE_AA, _SHIFT)


def _vehicle(picture: Image, half_px: float) -> None:
    """Draw an arrowhead in the middle, as large as a car; smaller where a car would hide a small robot's surroundings."""
    middle = picture.shape[0] / 2
    shape = np.array([[1.0, 0.0], [-1.0, 0.45], [-0.64, 0.0], [-1.0, -0.45]])
    pixels = np.stack([middle - shape[:, 1] * half_px, middle - shape[:, 0] * half_px], axis=1)
    cv2.fillPoly(picture, [np.rint(pixels * (1 << _SHIFT)).astype(np.int32)], ACCENT, cv2.LINE_AA, _SHIFT)
