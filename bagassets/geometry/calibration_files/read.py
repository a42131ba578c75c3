"""Reading a calibration file of whichever format it is: the content decides, not the name."""

import re
from collections.abc import Mapping

import yaml

from bagassets.base.errors import CalibrationError
from bagassets.base.json_types import Json
from bagassets.geometry.calibration_files.kalibr import CamchainFile, is_camchain
from bagassets.geometry.calibration_files.kapture import KaptureFile, is_kapture
from bagassets.geometry.calibration_files.matrices import MatrixFile
from bagassets.geometry.calibration_files.model import CalibrationFile

MOST_BYTES = 1_000_000
"""Size of the largest calibration file that is read: no real one comes near it."""

_EXPECTED = (
    "expected a ROS camera_calibration or OpenCV YAML (with camera_matrix), a Kalibr camchain (with cam0), or a "
    "sensors.txt or rigs.txt of kapture"
)
# Fields that ROS and OpenCV write for one camera; a file that lacks the first is one with a mistake.
_OF_ONE_CAMERA = ("camera_matrix", "distortion_coefficients", "distortion_model")
# `FileStorage` of OpenCV writes this, which is no directive of YAML.
_OPENCV_DIRECTIVE = re.compile(r"\A%YAML:1\.\d[^\n]*\n")


def read_calibration_file(data: bytes, name: str) -> CalibrationFile:
    """Return the cameras in a file; what it says of each is checked when it is asked for.

    Args:
        data: its content.
        name: of the file, for messages.

    Raises:
        CalibrationError: it is not a calibration file of a known kind.
    """
    if len(data) > MOST_BYTES:
        raise CalibrationError(f"{name}: {len(data)} bytes are too many for a calibration file; {_EXPECTED}.")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise CalibrationError(f"{name}: it is not UTF-8 text; {_EXPECTED}.") from None
    if is_kapture(text):
        return KaptureFile(text, name)
    if text.lstrip().startswith("<"):
        raise CalibrationError(
            f"{name}: it is XML; {_EXPECTED}. OpenCV writes YAML if the file's name ends in .yaml."
        )
    value = _parsed(text, name)
    if not isinstance(value, dict):
        raise CalibrationError(f"{name}: it holds {_describe(value)}; {_EXPECTED}.")
    if is_camchain(value):
        return CamchainFile(value, name)
    if not value.keys().isdisjoint(_OF_ONE_CAMERA):
        return MatrixFile(value, name)
    raise CalibrationError(f"{name}: it holds {_describe(value)}; {_EXPECTED}.")


def _parsed(text: str, name: str) -> Json:
    """Return YAML whose scalars all stay texts, so that no number becomes a date; tags mean nothing."""
    try:
        # The base loader makes no objects, whatever tags ask for.
        value: Json = yaml.load(_OPENCV_DIRECTIVE.sub("", text), Loader=yaml.BaseLoader)  # noqa: S506
    except (yaml.YAMLError, RecursionError) as err:
        mark = getattr(err, "problem_mark", None)
        # The directive is a line of the file, too.
        line = "" if mark is None else f", line {mark.line + 1 + bool(_OPENCV_DIRECTIVE.match(text))}"
        problem = getattr(err, "problem", None) or "it is nested too deeply"
        raise CalibrationError(f"{name}{line}: it is not YAML ({problem}); {_EXPECTED}.") from None
    return value


def _describe(value: Json | Mapping[str, Json]) -> str:
    if isinstance(value, dict):
        names = [str(key) for key in value]
        return f"the fields {', '.join(names[:6])}{', …' if len(names) > 6 else ''}" if names else "nothing"
    return "a list" if isinstance(value, list) else "plain text" if value else "nothing"
