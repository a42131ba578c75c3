"""Boxes of a sample."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import overload

import numpy as np

from bagassets.base.quantities import count_text
from bagassets.geometry.se3 import SE3, Floats

# As `box_in_image` of the devkit: every corner this far in front of the camera, and one farther away in the image.
_IN_FRONT_M = 0.1
_IN_IMAGE_M = 1.0


@dataclass(frozen=True)
class Box:
    """A box around an object, in the frame of the `Boxes` that it is in.

    Its own frame is in its centre: x ahead, y left, z up.

    Attributes:
        token: token of the annotation.
        instance: token of the object, the same in all samples of its scene.
        category: name, such as `vehicle.car`.
        attributes: names, such as `vehicle.parked`.
        visibility: level, such as `v80-100`; "" if unknown.
        pose: `frame_SE3_box`.
        size_m: width (along y), length (along x), height (along z).
        num_lidar_pts: lidar points in it.
        num_radar_pts: radar targets in it.
    """

    token: str
    instance: str
    category: str
    attributes: tuple[str, ...]
    visibility: str
    pose: SE3
    size_m: tuple[float, float, float]
    num_lidar_pts: int
    num_radar_pts: int

    @property
    def frame_SE3_box(self) -> Floats:
        """Its pose, (4, 4)."""
        return self.pose.matrix

    @property
    def center_m(self) -> Floats:
        """Its centre, (3,)."""
        return np.array(self.pose.translation)

    @property
    def rotation(self) -> Floats:
        """Its rotation `frame <- box` as a quaternion w, x, y, z."""
        return np.array(self.pose.rotation)

    @property
    def corners_m(self) -> Floats:
        """Its corners, (8, 3): four in front, then four behind, each clockwise from the upper left one, seen from behind."""
        width, length, height = self.size_m
        x = np.array([1, 1, 1, 1, -1, -1, -1, -1]) * length / 2
        y = np.array([1, -1, -1, 1, 1, -1, -1, 1]) * width / 2
        z = np.array([1, 1, -1, -1, 1, 1, -1, -1]) * height / 2
        return self.pose.transform_points(np.stack([x, y, z], axis=1))


@dataclass(frozen=True)
class View:
    """How a camera sees: `cam_SE3_global` at the time of its image, a function for its matrix, width and height of its image."""

    cam_SE3_global: SE3
    find_intrinsics: Callable[[], Floats]
    size_px: tuple[int, int]


class Boxes(Sequence[Box]):
    """The boxes of a sample, all in one frame.

    Attributes:
        frame: `global`, or the channel of a camera.
    """

    def __init__(self, boxes: Sequence[Box], frame: str, view: Callable[[str], View]) -> None:
        self._boxes = tuple(boxes)
        self._view = view
        self.frame = frame

    def __len__(self) -> int:
        return len(self._boxes)

    @overload
    def __getitem__(self, index: int) -> Box: ...
    @overload
    def __getitem__(self, index: slice) -> "Boxes": ...
    def __getitem__(self, index: int | slice) -> "Box | Boxes":
        if isinstance(index, slice):
            return Boxes(self._boxes[index], self.frame, self._view)
        return self._boxes[index]

    def __repr__(self) -> str:
        categories = sorted({box.category for box in self._boxes})
        return f"<{count_text(len(self), 'box')} in {self.frame}: {', '.join(categories) or 'none'}>"

    def in_camera(self, channel: str, *, visible_only: bool = False) -> "Boxes":
        """Return the boxes in the frame of a camera (x right, y down, z ahead) at the time of its image.

        Args:
            channel: the camera.
            visible_only: only boxes that are in front of the camera with at least one corner in its image, as the
                devkit's `get_sample_data` has them.

        Raises:
            KeyError: the sample has no image of this camera.
            DatasetError: it has no intrinsics, by which boxes would be visible.
            ValueError: these boxes are in the frame of a camera already.
        """
        if self.frame != "global":
            raise ValueError(
                f"these boxes are in {self.frame} already; use sample.boxes.in_camera({channel!r})."
            )
        view = self._view(channel)
        boxes = [replace(box, pose=view.cam_SE3_global @ box.pose) for box in self._boxes]
        if visible_only:
            k = view.find_intrinsics()
            boxes = [box for box in boxes if _is_in_image(box.corners_m, k, view.size_px)]
        return Boxes(boxes, channel, self._view)


def _is_in_image(corners_m: Floats, k: Floats, size_px: tuple[int, int]) -> bool:
    depths = corners_m[:, 2]
    if not (depths > _IN_FRONT_M).all():
        return False
    pixels = (corners_m @ k.T)[:, :2] / depths[:, None]
    inside = ((pixels > 0) & (pixels < np.array(size_px))).all(axis=1)
    return bool((inside & (depths > _IN_IMAGE_M)).any())
