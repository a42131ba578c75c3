"""What `calibration.json` says: where each sensor sits on the vehicle, and the lens of each camera.

Numbers stay as they were written, rounded to 12 significant digits: digests of actions are taken of them.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

from bagassets.geometry.se3 import SE3
from bagassets.json_types import JsonMapping

__all__ = [
    "CalibratedCamera",
    "CalibratedSensor",
    "Calibration",
    "CameraLens",
    "Mount",
    "Mounts",
    "RegionOfInterest",
]


@dataclass(frozen=True, slots=True)
class RegionOfInterest:
    """The part of the full-resolution image that is sent, in unbinned pixels."""

    x_offset: int
    y_offset: int
    width: int
    height: int
    do_rectify: bool


@dataclass(frozen=True, kw_only=True)
class CameraLens:
    """The parameters of a camera that shape its images, as defined by sensor_msgs/CameraInfo.

    Attributes:
        model: plumb_bob, rational_polynomial, equidistant or none.
        width: width of the full-resolution image in pixels.
        height: height of the full-resolution image in pixels.
        k: (9,) intrinsic matrix of the full-resolution image, row by row, pixels.
        d: coefficients of the model; empty for none.
        binning: pixels combined along x and y, at least 1.
        roi: part of the image that is sent.
    """

    model: str
    width: int
    height: int
    k: tuple[float, ...]
    d: tuple[float, ...]
    binning: tuple[int, int]
    roi: RegionOfInterest


@dataclass(frozen=True, kw_only=True)
class CalibratedCamera(CameraLens):
    """`camera` of a channel.

    Attributes:
        r: (9,) rectification.
        p: (12,) projection matrix, row by row.
        source: where it comes from: `camera_info`, `recipe`, or the name of a calibration file.
    """

    r: tuple[float, ...]
    p: tuple[float, ...]
    source: str

    @classmethod
    def from_json(cls, value: JsonMapping) -> Self:
        """Return what `as_json` of it was."""
        across, down = value["binning"]
        return cls(
            model=value["model"],
            width=value["width"],
            height=value["height"],
            k=tuple(value["k"]),
            d=tuple(value["d"]),
            binning=(across, down),
            roi=RegionOfInterest(**value["roi"]),
            r=tuple(value["r"]),
            p=tuple(value["p"]),
            source=value["source"],
        )

    @property
    def lens(self) -> CameraLens:
        """What of it shapes images."""
        return CameraLens(
            model=self.model,
            width=self.width,
            height=self.height,
            k=self.k,
            d=self.d,
            binning=self.binning,
            roi=self.roi,
        )


@dataclass(frozen=True)
class Mount:
    """Where a sensor sits on the vehicle.

    Attributes:
        frame: its frame in TF; empty if its messages name none.
        ego_SE3_sensor: its place; rounded, so the quaternion is of unit length but for the last digits.
    """

    frame: str
    ego_SE3_sensor: SE3


@dataclass(frozen=True)
class Mounts:
    """Where all sensors sit.

    Attributes:
        ego_frame: the frame that they are placed in.
        channels: channel -> where its sensor sits.
    """

    ego_frame: str
    channels: Mapping[str, Mount]


@dataclass(frozen=True)
class CalibratedSensor(Mount):
    """A channel of `calibration.json`.

    Attributes:
        source: what says where it sits.
        camera: its intrinsics; None if it is no camera, or they are not known.
    """

    source: str
    camera: CalibratedCamera | None

    @classmethod
    def from_json(cls, value: JsonMapping) -> Self:
        """Return what `as_json` of it was."""
        pose, camera = value["ego_SE3_sensor"], value["camera"]
        (w, x, y, z), (tx, ty, tz) = pose["rotation"], pose["translation"]
        return cls(
            value["frame"],
            SE3((w, x, y, z), (tx, ty, tz)),
            value["source"],
            None if camera is None else CalibratedCamera.from_json(camera),
        )


@dataclass(frozen=True)
class Calibration:
    """Content of `calibration.json`.

    Attributes:
        ego_frame: the frame that sensors are placed in.
        channels: channel -> its sensor.
        notes: sentences on what is unusual.
    """

    ego_frame: str
    channels: Mapping[str, CalibratedSensor]
    notes: tuple[str, ...] = ()

    @classmethod
    def from_json(cls, value: JsonMapping) -> Self:
        """Return what `as_json` of it was."""
        channels = {name: CalibratedSensor.from_json(one) for name, one in value["channels"].items()}
        return cls(value["ego_frame"], channels, tuple(value["notes"]))

    @property
    def mounts(self) -> Mounts:
        """Where the sensors sit, without their lenses."""
        channels = {name: Mount(one.frame, one.ego_SE3_sensor) for name, one in self.channels.items()}
        return Mounts(self.ego_frame, channels)
