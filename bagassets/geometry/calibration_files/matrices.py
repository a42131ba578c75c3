"""Files of one camera with matrices as `rows`, `cols`, `data`: those of ROS and of OpenCV.

ROS: `camera_calibration` writes `ost.yaml`, `camera_info_manager` reads it; the fields are those of
https://github.com/ros-perception/image_common, camera_calibration_parsers/src/parse_yml.cpp. OpenCV: the fields are those
that the calibration program of its tutorials writes with `FileStorage`
(https://docs.opencv.org/4.x/d4/d94/tutorial_camera_calibration.html). They share most names: ROS names a
`distortion_model`, OpenCV has `fisheye_model` instead, and tells its polynomial lenses apart by the number of coefficients.
"""

from collections.abc import Mapping

from bagassets.base.json_types import Json
from bagassets.base.quantities import count_text
from bagassets.geometry.calibration import COEFFICIENTS
from bagassets.geometry.calibration_files.model import CalibrationFile, Fields, FileLens

# As `cv::calibrateCamera` orders them.
_BY_LENGTH = {
    number: model for model in ("plumb_bob", "rational_polynomial") for number in COEFFICIENTS[model]
}


class MatrixFile(CalibrationFile):
    """A file of one camera with `camera_matrix`.

    Args:
        value: its content.
        name: of the file.
    """

    def __init__(self, value: Mapping[str, Json], name: str) -> None:
        super().__init__(name)
        self._fields = Fields(value, name)
        # Files of ROS without a model are from before there was one; they have matrices that OpenCV never writes.
        self._is_ros = any(
            self._fields.has(field)
            for field in ("distortion_model", "camera_name", "rectification_matrix", "projection_matrix")
        )
        self.kind = "a ROS camera calibration" if self._is_ros else "an OpenCV calibration"

    @property
    def cameras(self) -> tuple[str, ...]:
        """The camera's name, which only ROS has."""
        return (self._fields.text("camera_name", "a name") if self._fields.has("camera_name") else "",)

    def lens(self, camera: str, model: str | None) -> FileLens:
        """Return the intrinsics of the camera."""
        del camera
        fields = self._fields
        d = self._coefficients()
        if fields.has("distortion_model"):
            self.refuse_model(model)
            known = fields.text("distortion_model", "the name of a model")
        elif self._is_ros:
            known = model or "plumb_bob"  # what camera_calibration_parsers takes it for
        else:
            known = model or self._model_of(d)
        return FileLens(
            known,
            fields.whole("image_width", "the width of the images in pixels"),
            fields.whole("image_height", "the height of the images in pixels"),
            self._matrix("camera_matrix", "the intrinsic matrix K", 3),
            d,
            self._matrix_if_any("rectification_matrix", "the rectification R", 3),
            self._matrix_if_any("projection_matrix", "the projection matrix P", 4),
        )

    def _coefficients(self) -> tuple[float, ...]:
        meaning = "the coefficients of the lens"
        section = self._fields.section("distortion_coefficients", meaning)
        d = section.numbers("data", meaning)
        if section.has("rows") and section.has("cols"):
            rows, cols = section.number("rows", "a number of rows"), section.number("cols", "of columns")
            if d and 1 not in (rows, cols):
                raise self._fields.error(
                    "distortion_coefficients",
                    f"expected {meaning} in one row or column, found {rows:g}x{cols:g}",
                )
            if rows * cols != len(d):
                raise self._fields.error(
                    "distortion_coefficients",
                    f"`rows` and `cols` say {rows:g}x{cols:g}, but `data` has {count_text(len(d), 'number')}",
                )
        return d

    def _model_of(self, d: tuple[float, ...]) -> str:
        """Return the model of OpenCV, which names none."""
        fields = self._fields
        if fields.has("fisheye_model") and fields.number("fisheye_model", "1 for a fisheye lens, else 0"):
            return "equidistant"
        if not d:
            return ""
        if len(d) not in _BY_LENGTH:
            raise fields.error(
                "distortion_coefficients",
                f"OpenCV's lenses have 4, 5, 8, 12 or 14 coefficients, found {len(d)}",
            )
        return _BY_LENGTH[len(d)]

    def _matrix_if_any(self, field: str, meaning: str, cols: int) -> tuple[float, ...] | None:
        return self._matrix(field, meaning, cols) if self._fields.has(field) else None

    def _matrix(self, field: str, meaning: str, cols: int) -> tuple[float, ...]:
        """Return a matrix of three rows."""
        section = self._fields.section(field, meaning)
        for name, wanted in (("rows", 3), ("cols", cols)):
            if section.has(name) and section.number(name, "a number") != wanted:
                found = f"{section.text('rows', 'rows')}x{section.text('cols', 'columns')}"
                raise self._fields.error(field, f"expected {meaning}, 3x{cols}, found {found}")
        return section.numbers("data", meaning, 3 * cols)
