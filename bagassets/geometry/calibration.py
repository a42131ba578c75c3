"""What `calibration.json` says: where each sensor sits on the vehicle, and the lens of each camera.

Numbers stay as they were written, rounded to 12 significant digits: digests of actions are taken of them.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Self

from pydantic import TypeAdapter

from bagassets.base.json_types import JsonMapping
from bagassets.geometry.se3 import SE3

IDENTITY = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
"""A (3, 3) matrix, row by row."""
COEFFICIENTS: Mapping[str, tuple[int, ...]] = {
    "none": (0,),
    "plumb_bob": (4, 5),
    "rational_polynomial": (8, 12, 14),
    "equidistant": (4,),
}
"""OpenCV's numbers of coefficients: k1 k2 p1 p2 [k3 [k4 k5 k6 [s1-s4 [tx ty]]]], and k1-k4 of fisheye."""


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
class CameraCalibration(CameraLens):
    """What a CameraInfo says of a camera.

    Attributes:
        r: (9,) rectification, row by row.
        p: (12,) projection matrix, row by row.
    """

    r: tuple[float, ...]
    p: tuple[float, ...]

    @classmethod
    def of_lens(cls, model: str, width: int, height: int, k: tuple[float, ...], d: tuple[float, ...]) -> Self:
        """Return that of a camera that sends whole images; R is identity, and P is K without a baseline."""
        return cls(
            model=model,
            width=width,
            height=height,
            k=k,
            d=d,
            binning=(1, 1),
            roi=RegionOfInterest(0, 0, width, height, do_rectify=False),
            r=IDENTITY,
            p=(*k[:3], 0.0, *k[3:6], 0.0, *k[6:], 0.0),
        )

    @property
    def lens(self) -> CameraLens:
        """What of it shapes images: everything except R and P, which describe a stereo pair."""
        return CameraLens(**{field.name: getattr(self, field.name) for field in fields(CameraLens)})


@dataclass(frozen=True, kw_only=True)
class CalibratedCamera(CameraCalibration):
    """`camera` of a channel.

    Attributes:
        source: where it comes from: `camera_info`, `recipe`, or the name of a calibration file.
    """

    source: str


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


UNPLACED = "unknown"
"""Source of a sensor of which no dataset needs to know where it is."""


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
    def from_json(cls, value: JsonMapping) -> "Calibration":
        """Return what `as_json` of it was."""
        return _JSON.validate_python(value)

    @property
    def mounts(self) -> Mounts:
        """Where the sensors sit, without their lenses."""
        channels = {name: Mount(one.frame, one.ego_SE3_sensor) for name, one in self.channels.items()}
        return Mounts(self.ego_frame, channels)


_JSON = TypeAdapter(Calibration)
