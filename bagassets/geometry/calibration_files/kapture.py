"""Files of kapture: `sensors.txt` has intrinsics, `rigs.txt` has poses.

The format: https://github.com/naver/kapture/blob/main/kapture_format.adoc; models and the order of their parameters are those of
COLMAP. Principal points are taken as they are: kapture's importers of ROS calibrations write them so, too.
"""

import re

from bagassets.base.errors import CalibrationError
from bagassets.geometry.calibration_files.model import CalibrationFile, FileLens, FilePose, finite
from bagassets.geometry.se3 import SE3

# Model -> which of f, fx, fy, cx, cy and coefficients follow width and height, and the distortion model of CameraInfo.
_MODELS = {
    "SIMPLE_PINHOLE": (("f", "cx", "cy"), ""),
    "PINHOLE": (("fx", "fy", "cx", "cy"), ""),
    "SIMPLE_RADIAL": (("f", "cx", "cy", "k1"), "plumb_bob"),
    "RADIAL": (("f", "cx", "cy", "k1", "k2"), "plumb_bob"),
    "OPENCV": (("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"), "plumb_bob"),
    "FULL_OPENCV": (
        ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
        "rational_polynomial",
    ),
    "OPENCV_FISHEYE": (("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4"), "equidistant"),
    "SIMPLE_RADIAL_FISHEYE": (("f", "cx", "cy", "k1"), "equidistant"),
    "RADIAL_FISHEYE": (("f", "cx", "cy", "k1", "k2"), "equidistant"),
}
_ORDER = {
    "": (),
    "plumb_bob": ("k1", "k2", "p1", "p2"),
    "rational_polynomial": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    "equidistant": ("k1", "k2", "k3", "k4"),
}
_POSE = 9  # fields of a line in rigs.txt


def is_kapture(text: str) -> bool:
    """Return whether a text says in its first line that it is of kapture."""
    return re.match(r"#\s*kapture format", text) is not None


class KaptureFile(CalibrationFile):
    """A `sensors.txt` or a `rigs.txt`.

    Args:
        text: its content.
        name: of the file.
    """

    def __init__(self, text: str, name: str) -> None:
        super().__init__(name)
        lines = [
            (number, [field.strip() for field in line.split(",")])
            for number, line in enumerate(text.splitlines(), 1)
            if line.strip() and not line.lstrip().startswith("#")
        ]
        self._rigs = bool(lines) and all(_is_pose(fields) for _, fields in lines)
        self.kind = "a rigs.txt of kapture" if self._rigs else "a sensors.txt of kapture"
        self._lines: dict[str, tuple[int, list[str]]] = {}
        for number, fields in lines:
            sensor = fields[1] if self._rigs else fields[0]
            if not self._rigs and (len(fields) < 3 or fields[2] != "camera"):
                continue  # another kind of sensor
            if sensor in self._lines:
                raise CalibrationError(
                    f"{name}, line {number}: {sensor} stands there a second time, first in line {self._lines[sensor][0]}; "
                    "remove one of the two."
                )
            self._lines[sensor] = number, fields

    @property
    def cameras(self) -> tuple[str, ...]:
        """The ids of its cameras; in a `rigs.txt`, of all sensors."""
        return tuple(self._lines)

    def lens(self, camera: str, model: str | None) -> FileLens:
        """Return the intrinsics of a camera."""
        self.refuse_model(model)
        if self._rigs:
            raise CalibrationError(
                f"{self.name}: {self.kind} holds no intrinsics; name the sensors.txt beside it."
            )
        number, fields = self._lines[camera]
        place = f"{self.name}, line {number}"
        kind = fields[3] if len(fields) > 3 else ""
        if kind not in _MODELS:
            raise CalibrationError(
                f"{place}: the camera model {kind or '(none)'} of {camera} is not supported, only {', '.join(_MODELS)} are; "
                "correct the line, or give `intrinsics` by hand."
            )
        names, distortion = _MODELS[kind]
        wanted = ("width", "height", *names)
        numbers = [value for value in map(finite, fields[4:]) if value is not None]
        if not len(fields) - 4 == len(wanted) == len(numbers):
            raise CalibrationError(
                f"{place}: {kind} takes the numbers {', '.join(wanted)}, found {', '.join(fields[4:]) or 'none'}; "
                "correct the line."
            )
        known = dict(zip(wanted, numbers, strict=True))
        fx, fy = known.get("fx", known.get("f", 0.0)), known.get("fy", known.get("f", 0.0))
        width, height = known["width"], known["height"]
        if not (width.is_integer() and height.is_integer()):
            raise CalibrationError(
                f"{place}: width and height are whole numbers of pixels; correct the line."
            )
        k = (fx, 0.0, known["cx"], 0.0, fy, known["cy"], 0.0, 0.0, 1.0)
        d = tuple(known.get(name, 0.0) for name in _ORDER[distortion])
        return FileLens(distortion, int(width), int(height), k, d)

    def pose(self, camera: str) -> FilePose:
        """Return the pose of a sensor relative to its rig; the file has its inverse."""
        if not self._rigs:
            raise CalibrationError(
                f"{self.name}: {self.kind} holds no pose, as `extrinsics` needs; name the rigs.txt beside it."
            )
        _, fields = self._lines[camera]
        numbers = [float(field) for field in fields[2:]]
        sensor_SE3_rig = SE3.create(numbers[:4], numbers[4:])
        return FilePose(sensor_SE3_rig.inverse(), f"the rig {fields[0]}")


def _is_pose(fields: list[str]) -> bool:
    """Return whether a line is `rig, sensor, qw, qx, qy, qz, tx, ty, tz`."""
    numbers = [finite(field) for field in fields[2:]]
    if len(fields) != _POSE or any(number is None for number in numbers):
        return False
    return any(number for number in numbers[:4])
