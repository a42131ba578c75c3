"""`sensor_msgs/CameraInfo`: what a camera's calibration says, checked for plausibility."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite

from bagassets.base.errors import DecodeError
from bagassets.decode.fields import head
from bagassets.geometry.calibration import COEFFICIENTS, IDENTITY, CameraCalibration, RegionOfInterest
from bagassets.recordings.model import Message

_SIZES = {"k": 9, "r": 9, "p": 12}
# Names in the wild -> names of the models this package knows.
MODELS = {
    "plumb_bob": "plumb_bob",
    "rational_polynomial": "rational_polynomial",
    "equidistant": "equidistant",
    "fisheye": "equidistant",
    "kannala_brandt4": "equidistant",
    "": "none",
    "none": "none",
}


@dataclass(frozen=True, slots=True)
class CameraInfoReading:
    """One CameraInfo message.

    Attributes:
        stamp_ns: header stamp.
        frame_id: frame of the camera, without leading slash.
        calibration: R is identity if the message leaves it zero, and the region is the whole image.
        rectified: only P was filled in, as for images that were rectified before they were sent; K is P's.
    """

    stamp_ns: int
    frame_id: str
    calibration: CameraCalibration
    rectified: bool


def decode_camera_info(message: Message) -> CameraInfoReading:
    """Return the calibration in a CameraInfo of ROS 1 (K, D, R, P) or ROS 2 (k, d, r, p), or a `foxglove.CameraCalibration`.

    The latter has no binning and no region of interest; matrices that it leaves out are zero.

    Raises:
        DecodeError: the camera was never calibrated, the numbers are implausible, or the
            distortion model is not known.
    """
    stamp_ns, frame_id = head(message)
    k, r, p = (_numbers(message, name) for name in ("k", "r", "p"))
    width, height = int(message.width), int(message.height)
    if not all(isfinite(value) for value in (*r, *p)):
        raise DecodeError("R or P hold numbers that are not finite")
    d = _numbers(message, "d")
    rectified = not any(k)
    k = _matrix_of(p, d) if rectified else k
    model, d = ("none", ()) if rectified else named_distortion(str(message.distortion_model), d)
    check_lens(model, width, height, k, d)
    calibration = CameraCalibration(
        model=model,
        width=width,
        height=height,
        k=k,
        d=d,
        binning=(
            max(1, int(getattr(message, "binning_x", 1))),
            max(1, int(getattr(message, "binning_y", 1))),
        ),
        roi=_region(getattr(message, "roi", None), width, height),
        r=r if any(r) else IDENTITY,
        p=p,
    )
    return CameraInfoReading(stamp_ns, frame_id, calibration, rectified)


def _matrix_of(p: tuple[float, ...], d: tuple[float, ...]) -> tuple[float, ...]:
    """Return the camera matrix in P, for a message whose K is zero."""
    if p[0] <= 0 or p[5] <= 0:
        raise DecodeError("its K is all zeros, and P has no focal lengths, so the camera was not calibrated")
    if any(d):
        raise DecodeError("its K is all zeros, so nobody can tell what its D distorts")
    return *p[0:3], *p[4:7], *p[8:11]


def check_lens(model: str, width: int, height: int, k: Sequence[float], d: Sequence[float]) -> None:
    """Check intrinsics for what no camera can have.

    Raises:
        DecodeError: a number is implausible.
    """
    if width <= 0 or height <= 0:
        raise DecodeError(f"its image size is {width}x{height}")
    if not all(isfinite(v) for v in (*k, *d)):
        raise DecodeError("K or D hold numbers that are not finite")
    fx, skew, cx, _, fy, cy, *bottom = k
    if fx <= 0 or fy <= 0:
        raise DecodeError(f"its focal lengths must be positive, they are {fx:g} and {fy:g}")
    if skew != 0 or k[3] != 0 or bottom != [0, 0, 1]:
        raise DecodeError("its camera matrix is not of the form [fx 0 cx, 0 fy cy, 0 0 1]")
    if not (0 <= cx <= width and 0 <= cy <= height):
        raise DecodeError(f"its principal point ({cx:g}, {cy:g}) lies outside the image of {width}x{height}")
    if len(d) not in COEFFICIENTS[model]:
        allowed = " or ".join(str(n) for n in COEFFICIENTS[model])
        raise DecodeError(f"distortion model {model} has {allowed} coefficients, it holds {len(d)}")


def _numbers(message: Message, name: str) -> tuple[float, ...]:
    values = getattr(message, name, None)
    if values is None:  # ROS 1 spells them in capitals
        values = getattr(message, name.upper())
    size = _SIZES.get(name, len(values))
    if len(values) not in {0, size}:  # in protobuf and JSON, matrices are arrays of any length
        raise DecodeError(f"{name.upper()} must have {size} numbers, it has {len(values)}")
    return tuple(float(v) for v in values) or (0.0,) * size


def named_distortion(name: str, d: tuple[float, ...]) -> tuple[str, tuple[float, ...]]:
    """Return model and coefficients, given the name and the numbers that somebody wrote.

    Raises:
        DecodeError: the model is not known, or has none and yet coefficients.
    """
    model = MODELS.get(name.strip().lower())
    if model is None:
        known = ", ".join(name for name in COEFFICIENTS if name != "none")
        raise DecodeError(f"distortion model '{name}' is not known (known are {known})")
    if model == "none" and any(d):
        raise DecodeError("it names no distortion model but has coefficients")
    if model == "none" or not d:  # a driver without calibration of the lens leaves D empty: no distortion
        return "none", ()
    if model == "equidistant":
        return model, d
    return _polynomial(model, d)


def _polynomial(model: str, d: tuple[float, ...]) -> tuple[str, tuple[float, ...]]:
    """Return model and coefficients of OpenCV's one family of polynomial lenses, whose length tells the model.

    Drivers write eight numbers under the name plumb_bob, five under rational_polynomial, and fill up
    with zeros.
    """
    known = sorted({*COEFFICIENTS["plumb_bob"], *COEFFICIENTS["rational_polynomial"]})
    if len(d) not in known:
        significant = max((i + 1 for i, v in enumerate(d) if v != 0), default=0)
        length = next((n for n in known if n >= significant), len(d))
        if length == len(d):
            return model, d
        d = (*d[:length], *[0.0] * (length - len(d)))
    return ("plumb_bob" if len(d) in COEFFICIENTS["plumb_bob"] else "rational_polynomial"), d


def _region(roi: Message | None, width: int, height: int) -> RegionOfInterest:
    if roi is None:
        return RegionOfInterest(0, 0, width, height, False)
    region = RegionOfInterest(
        int(roi.x_offset),
        int(roi.y_offset),
        int(roi.width) or width - int(roi.x_offset),
        int(roi.height) or height - int(roi.y_offset),
        bool(roi.do_rectify),
    )
    if region.x_offset + region.width > width or region.y_offset + region.height > height:
        raise DecodeError(f"its region of interest reaches beyond the image of {width}x{height}")
    return region
