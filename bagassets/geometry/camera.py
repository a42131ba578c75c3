"""Camera models: from the calibration of a lens to pixels of the image that is written.

Distortion models are those of sensor_msgs/CameraInfo; K and D there describe the
full-resolution image, of which the recorded one is a region of interest, then binned.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from math import cos, sin

import cv2
import numpy as np
from numpy.typing import NDArray

from bagassets.errors import CalibrationError
from bagassets.geometry.calibration import CameraLens
from bagassets.geometry.se3 import Floats

__all__ = ["CameraModel"]


@dataclass(frozen=True, eq=False)
class CameraModel:
    """A camera as recorded: pinhole matrix and distortion of the image that is in the recording.

    Attributes:
        model: plumb_bob, rational_polynomial, equidistant or none.
        width: pixels of the recorded image.
        height: pixels of the recorded image.
        fx, fy, cx, cy: pinhole matrix of the recorded image, pixels.
        distortion: coefficients in the order of the model.
    """

    model: str
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()

    @classmethod
    def from_calibration(cls, camera: CameraLens) -> "CameraModel":
        """Return the model of the recorded image.

        ROI and binning as sensor_msgs/CameraInfo defines them: the region is cut out of the
        full image first, then `binning` pixels become one.
        """
        roi, (bx, by) = camera.roi, camera.binning
        fx, _, cx, _, fy, cy = camera.k[:6]
        # The centre of the first binned pixel lies (b - 1) / 2 into the unbinned ones.
        return cls(
            model=camera.model,
            width=roi.width // bx,
            height=roi.height // by,
            fx=fx / bx,
            fy=fy / by,
            cx=(cx - roi.x_offset - (bx - 1) / 2) / bx,
            cy=(cy - roi.y_offset - (by - 1) / 2) / by,
            distortion=camera.d,
        )

    @property
    def matrix(self) -> Floats:
        """K of the recorded image, (3, 3)."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @property
    def distorts(self) -> bool:
        """Return whether undistortion would change the image at all."""
        # The ideal equidistant lens has no coefficients and yet is no pinhole.
        return self.model == "equidistant" or (self.model != "none" and any(self.distortion))

    def undistorted(self, target: tuple[float, float, float, float] | None = None) -> "CameraModel":
        """Return the pinhole camera that undistorted images are written with (R = identity).

        Args:
            target: its fx, fy, cx, cy in pixels; None for those of this camera.
        """
        fx, fy, cx, cy = (self.fx, self.fy, self.cx, self.cy) if target is None else target
        return replace(self, model="none", distortion=(), fx=fx, fy=fy, cx=cx, cy=cy)

    def check_size(self, width: int, height: int, name: str, source: str = "") -> None:
        """Check that an image is the one that was calibrated.

        A calibration for another size is not scaled: nobody can tell whether images were scaled, binned or cut.

        Args:
            width: pixels of the image.
            height: pixels of the image.
            name: of the camera, for the message.
            source: where the calibration is from: `camera_info`, `recipe`, or the name of a file; "" if that is not known.

        Raises:
            CalibrationError: its size differs.
        """
        if (width, height) != (self.width, self.height):
            origin, advice = {
                "": ("", "correct the calibration"),
                "camera_info": ("", "correct the CameraInfo or give `intrinsics` in the recipe"),
                "recipe": (" in the recipe", "correct its `intrinsics`"),
            }.get(source, (f" in {source}", "name the calibration of these images in `intrinsics`"))
            raise CalibrationError(
                f"{name}: images are {width}x{height}, but the calibration{origin} is for {self.width}x{self.height}; "
                f"{advice}."
            )

    def project(self, points_cam: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Project (N, 3) points in the optical frame (z forward), metres.

        Returns:
            (N, 2) pixels u, v with distortion, and a mask (N,) of the points in front.
        """
        x, y, z = points_cam[:, 0], points_cam[:, 1], points_cam[:, 2]
        in_front: NDArray[np.bool_] = z > 1e-6
        depth = np.where(in_front, z, 1.0)
        xn, yn = self._distort(x / depth, y / depth)
        return np.stack([self.fx * xn + self.cx, self.fy * yn + self.cy], axis=1), in_front

    def _distort(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        if not self.distorts:
            return x, y
        if self.model == "equidistant":
            k1, k2, k3, k4 = self.distortion
            r = np.sqrt(x * x + y * y)
            theta = np.arctan(r)
            t2 = theta * theta
            bent = theta * (1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))
            scale = np.where(r > 1e-12, bent / np.where(r > 1e-12, r, 1.0), 1.0)
            return x * scale, y * scale
        coefficients = (*self.distortion, *[0.0] * (14 - len(self.distortion)))
        k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4, tilt_x, tilt_y = coefficients
        r2 = x * x + y * y
        radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        return _tilt(
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x) + r2 * (s1 + r2 * s2),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y + r2 * (s3 + r2 * s4),
            tilt_x,
            tilt_y,
        )

    @cached_property
    def _coefficients(self) -> Floats:
        return np.array(self.distortion, dtype=np.float64)

    def undistortion_maps(self, target: "CameraModel") -> tuple[NDArray[np.int16], NDArray[np.uint16]]:
        """Return fixed-point maps, (H, W, 2) int16 and (H, W) uint16, for `cv2.remap` from this camera's image to `target`'s.

        They take tens of milliseconds to make: once per camera, never per frame.
        """
        size = (target.width, target.height)
        if self.model == "equidistant":
            maps = cv2.fisheye.initUndistortRectifyMap(
                self.matrix, self._coefficients, np.eye(3), target.matrix, size, cv2.CV_16SC2
            )
        else:
            maps = cv2.initUndistortRectifyMap(
                self.matrix, self._coefficients, np.eye(3), target.matrix, size, cv2.CV_16SC2
            )
        xy, fraction = maps
        return np.asarray(xy, np.int16), np.asarray(fraction, np.uint16)


def _tilt(x: Floats, y: Floats, tilt_x: float, tilt_y: float) -> tuple[Floats, Floats]:
    """Project normalised coordinates onto a sensor turned by two angles in radians, as OpenCV defines it.

    https://docs.opencv.org/4.x/d9/d0c/group__calib3d.html, "tilted sensor".
    """
    if not (tilt_x or tilt_y):
        return x, y
    cx, sx, cy, sy = cos(tilt_x), sin(tilt_x), cos(tilt_y), sin(tilt_y)
    # Rows of R = Ry(tilt_y) Rx(tilt_x), in the signs of OpenCV.
    turned_x = cy * x + sy * sx * y - sy * cx
    turned_y = cx * y + sx
    turned_z = sy * x - cy * sx * y + cy * cx
    r13, r23, r33 = -sy * cx, sx, cy * cx
    return (r33 * turned_x - r13 * turned_z) / turned_z, (r33 * turned_y - r23 * turned_z) / turned_z
