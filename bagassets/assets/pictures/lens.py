"""Projecting points in space to pixels of an image as written."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bagassets.geometry.camera import CameraModel
from bagassets.geometry.se3 import SE3, Floats

__all__ = ["View"]

NEAREST_M = 0.5


@dataclass(frozen=True)
class View:
    """A camera at one moment.

    Attributes:
        camera: model of the image as written.
        global_SE3_cam: where it was; z points forward, y down.
    """

    camera: CameraModel
    global_SE3_cam: SE3

    def project(self, points_global: Floats, scale: float = 1.0) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        """Project (N, 3) points in the global frame.

        Args:
            points_global: metres.
            scale: pixels of the picture per pixel of the image.

        Returns:
            (N, 2) pixels u, v of the picture; (N,) distance along the optical axis in metres; and a mask (N,)
            of the points that are in front of the camera and inside the picture.
        """
        points_cam = self.global_SE3_cam.inverse().transform_points(points_global)
        pixels, in_front = self.camera.project(points_cam)
        depth = points_cam[:, 2]
        inside = (pixels >= -0.5).all(axis=1)
        inside &= (pixels[:, 0] < self.camera.width - 0.5) & (pixels[:, 1] < self.camera.height - 0.5)
        # Far outside its image a lens model may fold back into it, so only points in the cone of visible rays count.
        limit = 2.0 * max(self.camera.width / self.camera.fx, self.camera.height / self.camera.fy)
        inside &= np.abs(points_cam[:, :2]).max(axis=1) <= limit * np.maximum(depth, 0.0)
        # Pixel centres are at integers, before and after scaling.
        return (pixels + 0.5) * scale - 0.5, depth, in_front & inside & (depth > NEAREST_M)
