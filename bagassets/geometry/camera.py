"""Camera models: from the calibration of a lens to pixels of the image that is written.

Distortion models are those of sensor_msgs/CameraInfo; K and D there describe the
full-resolution image, of which the recorded one is a region of interest, then binned.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bagassets.base.errors import CalibrationError
from bagassets.geometry.calibration import CameraLens
from bagassets.geometry.portable import arctan_unit, sin_cos
from bagassets.geometry.se3 import Floats

# OpenCV's maps count 32nds of a pixel (INTER_BITS).
_STEP_BITS = 5
_STEPS = 1 << _STEP_BITS
_AT_ONCE = 16_384  # pixels, so that intermediate results stay in the processor's cache


@dataclass(frozen=True)
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
            name: of the image, for the message.
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
                f"{name} is {width}x{height}, but the calibration{origin} is for {self.width}x{self.height}; {advice}, "
                "or, if the size of images changes there, split the recording."
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
        """Return where the lens puts rays (x, y, 1), for arrays of shapes that go together.

        Only what IEEE 754 rounds in one way is used, so that every processor gives the same bits.
        """
        if not self.distorts:
            return x, y
        r2 = x * x + y * y
        if self.model == "equidistant":
            r = np.sqrt(r2)
            theta = 2.0 * arctan_unit(r / (1.0 + np.sqrt(1.0 + r2)))
            bent = theta + theta * _series(theta * theta, *self.distortion)
            scale = np.where(r > 1e-12, bent / np.where(r > 1e-12, r, 1.0), 1.0)
            return x * scale, y * scale
        coefficients = (*self.distortion, *[0.0] * (14 - len(self.distortion)))
        k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4, tilt_x, tilt_y = coefficients
        radial: Floats | float = 1.0 + _series(r2, k1, k2, k3)
        if k4 or k5 or k6:
            radial = radial / (1.0 + _series(r2, k4, k5, k6))
        if p1 or p2:
            radial = radial + (2 * p1 * y + 2 * p2 * x)
        bent_x = x * radial + _series(r2, p2 + s1, s2)
        bent_y = y * radial + _series(r2, p1 + s3, s4)
        return _tilt(bent_x, bent_y, tilt_x, tilt_y)

    def undistortion_maps(self, target: "CameraModel") -> tuple[NDArray[np.int16], NDArray[np.uint16]]:
        """Return fixed-point maps, (H, W, 2) int16 and (H, W) uint16, for `cv2.remap` from this camera's image to `target`'s.

        They are those of `cv2.initUndistortRectifyMap`, but for places just between two 32nds of a pixel: there OpenCV's last
        bits decide, and they depend on the processor, in its float maps, too.
        They take some ten milliseconds to make: once per camera, never per frame.
        """
        across = (np.arange(target.width, dtype=np.float64) - target.cx) / target.fx
        down = ((np.arange(target.height, dtype=np.float64) - target.cy) / target.fy)[:, np.newaxis]
        xy = np.empty((target.height, target.width, 2), np.int16)
        fraction = np.empty((target.height, target.width), np.uint16)
        rows = max(1, _AT_ONCE // target.width)
        with np.errstate(divide="ignore", invalid="ignore"):  # where a ray never meets the sensor
            for begin in range(0, target.height, rows):
                part = slice(begin, begin + rows)
                x, y = self._distort(across, down[part])
                u = _rounded(_STEPS * self.fx * x + _STEPS * self.cx)
                v = _rounded(_STEPS * self.fy * y + _STEPS * self.cy)
                xy[part, :, 0], xy[part, :, 1] = u >> _STEP_BITS, v >> _STEP_BITS
                parts_x, parts_y = (steps.astype(np.int16) & _STEPS - 1 for steps in (u, v))
                fraction[part] = parts_y << _STEP_BITS | parts_x
        return xy, fraction


def _series(r2: Floats, *coefficients: float) -> Floats | float:
    """Return c1 r² + c2 r⁴ + …; a plain zero if all coefficients are."""
    total: Floats | float = 0.0
    last = max((i for i, value in enumerate(coefficients) if value), default=-1)
    for coefficient in reversed(coefficients[: last + 1]):
        total = (total + coefficient) * r2
    return total


def _rounded(steps: Floats) -> NDArray[np.int32]:
    """Round places in steps, halves to even; what is beyond 16 bits of pixels, or nowhere, stays outside the image."""
    least, most = -32768.0 * _STEPS, 32767.0 * _STEPS
    if not (steps.min() >= least and steps.max() <= most):
        steps = np.fmin(np.fmax(steps, least), most)  # these take the other operand for what is not a number
    return np.rint(steps).astype(np.int32)


def _tilt(x: Floats, y: Floats, tilt_x: float, tilt_y: float) -> tuple[Floats, Floats]:
    """Project normalised coordinates onto a sensor turned by two angles in radians, as OpenCV defines it.

    https://docs.opencv.org/4.x/d9/d0c/group__calib3d.html, "tilted sensor".
    """
    if not (tilt_x or tilt_y):
        return x, y
    (sx, sy), (cx, cy) = sin_cos(np.array([tilt_x, tilt_y]))
    # Rows of R = Ry(tilt_y) Rx(tilt_x), in the signs of OpenCV.
    turned_x = cy * x + sy * sx * y - sy * cx
    turned_y = cx * y + sx
    turned_z = sy * x - cy * sx * y + cy * cx
    r13, r23, r33 = -sy * cx, sx, cy * cx
    return (r33 * turned_x - r13 * turned_z) / turned_z, (r33 * turned_y - r23 * turned_z) / turned_z
