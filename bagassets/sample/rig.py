"""The sample car: its sensors, where they sit, and how they see."""

from dataclasses import dataclass

import numpy as np

from bagassets.geometry.camera import CameraModel
from bagassets.geometry.se3 import SE3, quaternion_from_rotation


@dataclass(frozen=True)
class Camera:
    """A camera.

    Attributes:
        channel: canonical channel.
        name: of its topics, `/<name>/…`.
        frame: optical frame: z forward, x right, y down.
        ego_SE3_cam: where it sits.
        model: how it projects.
        encoding: of its messages; `jpeg` for compressed ones.
    """

    channel: str
    name: str
    frame: str
    ego_SE3_cam: SE3
    model: CameraModel
    encoding: str


@dataclass(frozen=True)
class Lidar:
    """A spinning lidar: rings at equal steps of elevation, columns at equal steps of azimuth."""

    rings: int
    columns: int
    lowest_deg: float
    highest_deg: float
    period_ns: int
    range_m: float


LIDAR = Lidar(32, 720, -24.0, 8.0, 100_000_000, 80.0)
EGO_SE3_LIDAR = SE3((1.0, 0.0, 0.0, 0.0), (0.9, 0.0, 1.85))
EGO_SE3_RADAR = SE3((1.0, 0.0, 0.0, 0.0), (3.6, 0.0, 0.5))
RADAR = Lidar(1, 120, 0.0, 0.0, 77_000_000, 70.0)

_DISTORTION = {
    "plumb_bob": (-0.16, 0.03, 0.0008, -0.0006, 0.0),
    "rational_polynomial": (0.12, -0.06, 0.0005, 0.0007, 0.004, 0.31, -0.05, 0.006),
    "equidistant": (0.03, -0.008, 0.002, -0.0005),
}


def cameras(width: int, height: int) -> list[Camera]:
    """Return the three cameras at an image size: three lens models, three kinds of messages."""
    return [
        _camera("CAM_FRONT", "cam_front", 0.0, "plumb_bob", "bayer_rggb8", width, height, 0.62),
        _camera("CAM_FRONT_LEFT", "cam_front_left", 55.0, "rational_polynomial", "rgb8", width, height, 0.6),
        _camera("CAM_FRONT_RIGHT", "cam_front_right", -55.0, "equidistant", "jpeg", width, height, 0.55),
    ]


def rear_camera(width: int, height: int) -> Camera:
    """Return a fourth camera, which looks back."""
    return _camera("CAM_BACK", "cam_back", 180.0, "plumb_bob", "bayer_rggb8", width, height, 0.62)


def _camera(
    channel: str, name: str, yaw_deg: float, lens: str, encoding: str, width: int, height: int, focal: float
) -> Camera:
    yaw = np.deg2rad(yaw_deg)
    # Columns: where the optical axes x (right), y (down) and z (forward) point in the car.
    rotation = np.array([[np.sin(yaw), 0.0, np.cos(yaw)], [-np.cos(yaw), 0.0, np.sin(yaw)], [0.0, -1.0, 0.0]])
    ego_SE3_cam = SE3.create(
        quaternion_from_rotation(rotation), (0.5 + 1.1 * np.cos(yaw), 0.3 * np.sin(yaw), 1.45)
    )
    fx = focal * width
    model = CameraModel(
        lens, width, height, fx, fx, width / 2 - 0.5 + 2.0, height / 2 - 0.5 - 1.0, _DISTORTION[lens]
    )
    return Camera(channel, name, f"{name}_optical", ego_SE3_cam, model, encoding)
