"""Recipe sections about the calibration of cameras: by hand, or from a file."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import Discriminator, Field, Tag

from bagassets.recipe.model_base import CameraName, FrameName, Model, Transform

LensModel = Literal["plumb_bob", "rational_polynomial", "equidistant"]


class Intrinsics(Model):
    """Camera calibration for recordings without CameraInfo."""

    model: LensModel = Field("plumb_bob", description="Distortion model, named as in sensor_msgs/CameraInfo.")
    width: int = Field(gt=0, description="Image width in pixels.")
    height: int = Field(gt=0, description="Image height in pixels.")
    fx: float = Field(gt=0, description="Focal length in pixels.")
    fy: float = Field(gt=0, description="Focal length in pixels.")
    cx: float = Field(description="Principal point in pixels.")
    cy: float = Field(description="Principal point in pixels.")
    distortion: tuple[float, ...] = Field(
        (), description="Coefficients in the order of the model; empty: no distortion."
    )


class PinholeIntrinsics(Model):
    """The pinhole matrix K of undistorted images."""

    fx: float = Field(gt=0, description="Focal length in pixels.")
    fy: float = Field(gt=0, description="Focal length in pixels.")
    cx: float = Field(description="Principal point in pixels.")
    cy: float = Field(description="Principal point in pixels.")


class CalibrationFile(Model):
    """A calibration file, and which of its cameras is meant."""

    keyed_by: ClassVar[str] = "file"

    file: Path = Field(
        description="The calibration file. When its content changes, what depends on it is made again."
    )
    camera: CameraName | None = Field(
        None,
        description="Name of the camera in the file, as in `cam0`; default: the only one, or the one whose `rostopic` is "
        "the channel's topic.",
    )


class IntrinsicsFile(CalibrationFile):
    """Intrinsics from a file: ROS camera_calibration, Kalibr camchain, OpenCV or kapture `sensors.txt` (`bagassets docs page poses`)."""

    model: LensModel | None = Field(
        None,
        description="Distortion model of an OpenCV file, which names none; default: by `fisheye_model` and the number of coefficients.",
    )


class ExtrinsicsFile(CalibrationFile):
    """The pose of a camera from a file: Kalibr camchain or kapture `rigs.txt` (`bagassets docs page poses`)."""

    relative_to: FrameName | None = Field(
        None,
        description="Frame in which the file places the camera: that of Kalibr's IMU, of its `cam0` if there is no IMU, or of "
        "kapture's rig; TF or the URDF relates it to the ego frame. Default: the ego frame, except for `cam0`.",
    )


def _kind(value: object) -> str:
    """Return which kind of value stands in a recipe: a text was probably meant to be the name of a file."""
    keyed = isinstance(value, str | CalibrationFile) or (isinstance(value, Mapping) and "file" in value)
    return "from a file" if keyed else "by hand"


CameraIntrinsics = Annotated[
    Annotated[Intrinsics, Tag("by hand")] | Annotated[IntrinsicsFile, Tag("from a file")],
    Discriminator(_kind),
]
CameraExtrinsics = Annotated[
    Annotated[Transform, Tag("by hand")] | Annotated[ExtrinsicsFile, Tag("from a file")], Discriminator(_kind)
]
