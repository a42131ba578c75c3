"""What a decoder from outside may get wrong about a reading, and that a sound one has no problem."""

from dataclasses import replace

import numpy as np
import pytest

from bagassets.decode.model import BoxReading, CloudReading, ImageReading, PoseReading, RadarReading
from bagassets.decode.readings import problem_of
from bagassets.geometry.se3 import SE3

GREY = ImageReading(1, "cam", np.zeros((2, 3), np.uint8), None, "mono8")
JPEG = ImageReading(1, "cam", None, b"\xff\xd8\xff\xe0", "jpeg")
PNG = ImageReading(1, "cam", None, b"\x89PNG\r\n\x1a\n", "png:bayer_rggb8")
CLOUD = CloudReading(1, "lidar", np.zeros((4, 5), np.float32), np.zeros(4, np.int64))
RADAR = RadarReading(1, "radar", {name: np.zeros(3) for name in ("x", "y", "z", "rcs")})
POSE = PoseReading(1, "map", "base", SE3())
BOX = BoxReading(1, "map", SE3(), (1.0, 2.0, 3.0), "7", "car", ("vehicle.parked",), 1.0)


@pytest.mark.parametrize(
    "reading",
    [
        GREY,
        JPEG,
        PNG,
        replace(GREY, pixels=np.zeros((2, 3), np.uint16), encoding="mono16"),
        replace(GREY, pixels=np.zeros((2, 3, 4), np.uint8), encoding="bgra8"),
        CLOUD,
        replace(CLOUD, times_ns=None),
        replace(CLOUD, points=np.zeros((0, 5), np.float32), times_ns=np.zeros(0, np.int64)),
        RADAR,
        POSE,
        BOX,
    ],
)
def test_a_sound_reading_has_no_problem(reading):
    assert problem_of(reading) is None


@pytest.mark.parametrize(
    ("reading", "problem"),
    [
        (replace(GREY, frame_id=None), "frame_id is no text"),
        (replace(BOX, frame_id=b"map"), "frame_id is no text"),
        (replace(GREY, stamp_ns=1.0), "stamp_ns is no integer"),
        (replace(POSE, stamp_ns=np.int64(1)), "stamp_ns is no integer"),
        (replace(GREY, pixels=None), "pixels and encoded bytes are both given, or neither"),
        (replace(GREY, encoded=b"\xff\xd8\xff"), "pixels and encoded bytes are both given, or neither"),
        (
            replace(JPEG, encoded=b"\x89PNG\r\n\x1a\n"),
            "encoded bytes are not what its encoding says, jpeg or png",
        ),
        (replace(PNG, encoded=b"\x89PNG"), "encoded bytes are not what its encoding says, jpeg or png"),
        (replace(JPEG, encoding="tiff"), "encoded bytes are not what its encoding says, jpeg or png"),
        (replace(GREY, encoding="MONO8"), "encoding is none of sensor_msgs/Image in lower case"),
        (replace(GREY, encoding="mono16"), "pixels do not fit its encoding"),
        (replace(GREY, encoding="bgr8"), "pixels do not fit its encoding"),
        (replace(GREY, pixels=np.zeros((2, 3, 1), np.uint8)), "pixels do not fit its encoding"),
        (
            replace(GREY, pixels=np.zeros((2, 3, 4), np.uint8), encoding="rgb8"),
            "pixels do not fit its encoding",
        ),
        (replace(GREY, pixels=[[0]]), "pixels do not fit its encoding"),
        (replace(CLOUD, points=np.zeros((4, 5))), "points are not (N, 5) float32"),
        (replace(CLOUD, points=np.zeros((4, 4), np.float32)), "points are not (N, 5) float32"),
        (replace(CLOUD, times_ns=np.zeros(3, np.int64)), "times_ns are not (N,) int64"),
        (replace(CLOUD, times_ns=np.zeros(4)), "times_ns are not (N,) int64"),
        (replace(RADAR, targets={"x": np.zeros(3), "y": np.zeros(3)}), "targets lack x, y or z"),
        (replace(RADAR, targets=RADAR.targets | {"rcs": np.zeros(2)}), "targets are not (N,) float64"),
        (
            replace(RADAR, targets=RADAR.targets | {"z": np.zeros(3, np.float32)}),
            "targets are not (N,) float64",
        ),
        (replace(POSE, parent_SE3_child=np.eye(4)), "parent_SE3_child is no SE3"),
        (replace(BOX, frame_SE3_box=np.eye(4)), "frame_SE3_box is no SE3"),
        (replace(BOX, size_m=(1.0, 2.0)), "size_m is not three floats"),
        (replace(BOX, size_m=(1.0, 2.0, 3)), "size_m is not three floats"),
        (replace(BOX, track_id=7), "track_id, category or attributes are no text"),
        (replace(BOX, category=None), "track_id, category or attributes are no text"),
        (replace(BOX, attributes=("a", 1)), "track_id, category or attributes are no text"),
    ],
)
def test_what_is_wrong_is_said(reading, problem):
    assert problem_of(reading) == problem
