"""Kalibr's camera chains: `camchain.yaml`, and `camchain-imucam.yaml` with the IMU.

The format: https://github.com/ethz-asl/kalibr/wiki/yaml-formats. `T_cam_imu` is `cam_SE3_imu`, and `T_cn_cnm1` relates a camera
to the one before it, `cam1_SE3_cam0`. A file of cameras alone relates them to `cam0`.
"""

import re
from collections.abc import Mapping

from bagassets.base.errors import CalibrationError
from bagassets.base.json_types import Json
from bagassets.geometry.calibration_files.model import CalibrationFile, Fields, FileLens, FilePose
from bagassets.geometry.se3 import SE3

_CAMERA = re.compile(r"cam(\d+)")
# Kalibr's names of distortion models -> those of sensor_msgs/CameraInfo, and their numbers of coefficients.
_MODELS = {"radtan": ("plumb_bob", 4), "equidistant": ("equidistant", 4), "none": ("", 0)}
_CHAIN = "T_cn_cnm1"


def is_camchain(value: Mapping[str, Json]) -> bool:
    """Return whether the content of a file is a chain of cameras."""
    return any(_CAMERA.fullmatch(key) and isinstance(one, dict) for key, one in value.items())


class CamchainFile(CalibrationFile):
    """A chain of cameras.

    Args:
        value: its content.
        name: of the file.
    """

    kind = "a Kalibr camchain"

    def __init__(self, value: Mapping[str, Json], name: str) -> None:
        super().__init__(name)
        whole = Fields(value, name)
        numbers = sorted(int(match[1]) for key in value if (match := _CAMERA.fullmatch(key)))
        self._fields = {
            f"cam{number}": whole.section(f"cam{number}", "the parameters of a camera") for number in numbers
        }

    @property
    def cameras(self) -> tuple[str, ...]:
        """The names of its cameras, in the order of the chain."""
        return tuple(self._fields)

    def topic(self, camera: str) -> str:
        """Return the topic of a camera's images."""
        fields = self._fields[camera]
        return fields.text("rostopic", "a topic") if fields.has("rostopic") else ""

    def lens(self, camera: str, model: str | None) -> FileLens:
        """Return the intrinsics of a camera."""
        self.refuse_model(model)
        fields = self._fields[camera]
        projection = fields.text("camera_model", "`pinhole`")
        if projection != "pinhole":
            raise CalibrationError(
                f"{self.name}: {camera}.camera_model: the model {projection} is not supported, only pinhole is; calibrate "
                "with a pinhole model, such as pinhole-equi for a fisheye."
            )
        distortion = fields.text("distortion_model", "radtan, equidistant or none")
        if distortion not in _MODELS:
            raise CalibrationError(
                f"{self.name}: {camera}.distortion_model: the model {distortion} is not supported, only radtan, equidistant and "
                "none are; calibrate with pinhole-radtan or pinhole-equi."
            )
        name, count = _MODELS[distortion]
        meaning = f"the coefficients of {distortion}"
        d = fields.numbers("distortion_coeffs", meaning, count) if count else ()
        fu, fv, pu, pv = fields.numbers("intrinsics", "fu, fv, pu, pv", 4)
        width, height = fields.numbers("resolution", "width and height in pixels", 2)
        if not (width.is_integer() and height.is_integer() and width > 0 and height > 0):
            raise fields.error(
                "resolution", f"expected width and height in pixels, found {width:g} and {height:g}"
            )
        k = (fu, 0.0, pu, 0.0, fv, pv, 0.0, 0.0, 1.0)
        return FileLens(name, int(width), int(height), k, d)

    def pose(self, camera: str) -> FilePose:
        """Return the pose of a camera relative to the IMU, or to the first of the chain if there is none."""
        camera_SE3_here = SE3()
        number = int(camera.removeprefix("cam"))
        while True:
            here = f"cam{number}"
            if here not in self._fields:
                raise CalibrationError(
                    f"{self.name}: the chain from {camera} needs {here}, which is missing; name the file with all cameras."
                )
            fields = self._fields[here]
            if fields.has("T_cam_imu"):
                here_SE3_imu = fields.transform("T_cam_imu", "the transform from the IMU to the camera")
                pose = (camera_SE3_here @ here_SE3_imu).inverse()
                return FilePose(pose, "the IMU", notes=self._shift(camera))
            if number == 0:
                return FilePose(camera_SE3_here.inverse(), here, is_sensor=True)
            here_SE3_previous = fields.transform(_CHAIN, "the transform from the camera before it")
            camera_SE3_here = camera_SE3_here @ here_SE3_previous
            number -= 1

    def _shift(self, camera: str) -> tuple[str, ...]:
        fields = self._fields[camera]
        if not fields.has("timeshift_cam_imu"):
            return ()
        shift_s = fields.number("timeshift_cam_imu", "seconds")
        # Shifts below this are what a calibration of synchronized sensors gives, too.
        if abs(shift_s) < 1e-3:
            return ()
        return (f"timeshift_cam_imu of {camera} is {shift_s * 1e3:.3g} ms; stamps are not shifted by it",)
