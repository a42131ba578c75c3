"""CameraInfo: both spellings, every lens model under the names drivers give it, and nonsense."""

import math

import numpy as np
import pytest

from bagassets.base.errors import DecodeError
from bagassets.decode.camera_info import decode_camera_info
from bagassets.geometry.calibration import RegionOfInterest
from bagassets_tests.pose_data import T0, camera_info, region

FIVE = (-0.2, 0.05, 0.001, -0.002, 0.01)
EIGHT = (0.1, -0.05, 0.001, -0.001, 0.01, 0.2, -0.02, 0.003)


@pytest.mark.parametrize("ros1", [True, False])
def test_fields_of_ros_1_and_ros_2(ros1):
    reading = decode_camera_info(camera_info(frame="/cam", d=FIVE, ros1=ros1))
    calibration = reading.calibration
    assert (reading.stamp_ns, reading.frame_id) == (T0, "cam")
    assert (calibration.model, calibration.d) == ("plumb_bob", FIVE)
    assert calibration.k == (400.0, 0, 320.0, 0, 410.0, 240.0, 0, 0, 1)
    assert calibration.r == (1, 0, 0, 0, 1, 0, 0, 0, 1)
    assert (calibration.width, calibration.height, calibration.binning) == (640, 480, (1, 1))


@pytest.mark.parametrize(
    ("name", "d", "expected"),
    [
        ("plumb_bob", FIVE, ("plumb_bob", FIVE)),
        ("plumb_bob", FIVE[:4], ("plumb_bob", FIVE[:4])),
        ("plumb_bob", (), ("none", ())),
        ("plumb_bob", EIGHT, ("rational_polynomial", EIGHT)),
        ("plumb_bob", (*FIVE, 0.0, 0.0, 0.0), ("rational_polynomial", (*FIVE, 0.0, 0.0, 0.0))),
        ("plumb_bob", (*FIVE, 0.0), ("plumb_bob", FIVE)),
        ("plumb_bob", (0.0,), ("plumb_bob", (0.0,) * 4)),
        ("plumb_bob", (-0.3, 0.1), ("plumb_bob", (-0.3, 0.1, 0.0, 0.0))),
        ("rational_polynomial", EIGHT, ("rational_polynomial", EIGHT)),
        ("rational_polynomial", FIVE, ("plumb_bob", FIVE)),
        ("rational_polynomial", (*EIGHT, 0.0, 0.0), ("rational_polynomial", EIGHT)),
        ("rational_polynomial", EIGHT + FIVE[:4], ("rational_polynomial", EIGHT + FIVE[:4])),
        ("equidistant", FIVE[:4], ("equidistant", FIVE[:4])),
        ("equidistant", (0.0,) * 4, ("equidistant", (0.0,) * 4)),
        ("fisheye", FIVE[:4], ("equidistant", FIVE[:4])),
        ("Kannala_Brandt4 ", FIVE[:4], ("equidistant", FIVE[:4])),
        ("", (), ("none", ())),
        ("", (0.0,) * 5, ("none", ())),
    ],
)
def test_models_and_coefficients(name, d, expected):
    calibration = decode_camera_info(camera_info(model=name, d=d)).calibration
    assert (calibration.model, calibration.d) == expected


def test_region_and_binning():
    message = camera_info(roi=region(10, 20, 300, 200), binning_x=2, binning_y=0)
    calibration = decode_camera_info(message).calibration
    assert calibration.roi == RegionOfInterest(10, 20, 300, 200, do_rectify=False)
    assert calibration.binning == (2, 1)
    whole = decode_camera_info(camera_info()).calibration.roi
    assert (whole.width, whole.height) == (640, 480)
    rest = decode_camera_info(camera_info(roi=region(40, 80))).calibration.roi
    assert (rest.width, rest.height) == (600, 400)


def test_rectification_left_zero_is_none():
    assert decode_camera_info(camera_info(r=np.zeros(9))).calibration.r == (1, 0, 0, 0, 1, 0, 0, 0, 1)


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"k": (0, 0, 0, 0)}, r"not of the form|focal lengths"),
        ({"k": (-400.0, 400.0, 320.0, 240.0)}, "focal lengths must be positive, they are -400 and 400"),
        (
            {"k": (400.0, 400.0, 700.0, 240.0)},
            r"principal point \(700, 240\) lies outside the image of 640x480",
        ),
        ({"k": (400.0, math.nan, 320.0, 240.0)}, "not finite"),
        ({"d": (math.inf,) * 5}, "not finite"),
        ({"r": np.full(9, math.nan)}, "R or P hold numbers that are not finite"),
        ({"p": np.full(12, math.inf)}, "R or P hold numbers that are not finite"),
        ({"d": (0.1,) * 15}, "distortion model plumb_bob has 4 or 5 coefficients, it holds 15"),
        ({"model": "equidistant", "d": FIVE}, "equidistant has 4 coefficients, it holds 5"),
        ({"model": "mei", "d": FIVE}, "'mei' is not known"),
        ({"model": "", "d": FIVE}, "names no distortion model but has coefficients"),
        ({"width": 0}, "image size is 0x480"),
        ({"roi": region(500, 0, 200, 100)}, "region of interest reaches beyond the image"),
    ],
)
def test_nonsense_is_refused(changes, problem):
    with pytest.raises(DecodeError, match=problem):
        decode_camera_info(camera_info(**changes))


@pytest.mark.parametrize("cx", [0.0, 640.0])
@pytest.mark.parametrize("cy", [0.0, 480.0])
def test_a_principal_point_may_lie_on_the_border(cx, cy):
    calibration = decode_camera_info(camera_info(k=(400.0, 400.0, cx, cy))).calibration
    assert (calibration.k[2], calibration.k[5]) == (cx, cy)


@pytest.mark.parametrize(("cx", "cy"), [(-0.1, 240.0), (320.0, -0.1), (640.1, 240.0), (320.0, 480.1)])
def test_a_principal_point_beyond_the_border_is_refused(cx, cy):
    with pytest.raises(DecodeError, match="lies outside the image"):
        decode_camera_info(camera_info(k=(400.0, 400.0, cx, cy)))


@pytest.mark.parametrize(
    ("x", "y", "width", "height", "fits"),
    [
        (340, 380, 300, 100, True),
        (341, 380, 300, 100, False),
        (340, 381, 300, 100, False),
        (341, 381, 0, 0, True),
    ],
)
def test_a_region_may_reach_the_border_of_the_image(x, y, width, height, fits):
    message = camera_info(roi=region(x, y, width, height))
    if fits:
        region_of = decode_camera_info(message).calibration.roi
        assert (region_of.width, region_of.height) == (width or 640 - x, height or 480 - y)
    else:
        with pytest.raises(DecodeError, match="region of interest reaches beyond the image"):
            decode_camera_info(message)


@pytest.mark.parametrize(("name", "size"), [("k", 5), ("k", 10), ("r", 8), ("p", 9)])
def test_a_matrix_of_another_size_is_refused(name, size):  # protobuf and JSON have arrays of any length
    message = camera_info()
    expected = len(getattr(message, name))
    setattr(message, name, np.ones(size))
    with pytest.raises(DecodeError, match=f"{name.upper()} must have {expected} numbers, it has {size}"):
        decode_camera_info(message)


@pytest.mark.parametrize("place", [1, 3, 6, 7, 8])
def test_a_matrix_of_another_form_is_refused(place):
    message = camera_info()
    message.k = np.array([400.0, 0, 320, 0, 410, 240, 0, 0, 1])
    message.k[place] += 0.5
    with pytest.raises(DecodeError, match="its camera matrix is not of the form"):
        decode_camera_info(message)


def test_a_camera_that_was_never_calibrated():
    message = camera_info()
    message.k = np.zeros(9)
    problem = "its K is all zeros, and P has no focal lengths, so the camera was not calibrated"
    with pytest.raises(DecodeError, match=problem):
        decode_camera_info(message)


P = np.array([300.0, 0, 310, -45.0, 0, 305, 230, 0, 0, 0, 1, 0])


@pytest.mark.parametrize("ros1", [True, False])
@pytest.mark.parametrize("model", ["", "plumb_bob", "whatever"])
@pytest.mark.parametrize("d", [(), (0.0,) * 5])
def test_where_only_p_is_filled_in_it_counts(ros1, model, d):
    """As drivers of rectified cameras send it."""
    names = {"k": np.zeros(9), "r": np.zeros(9), "p": P}
    message = camera_info(model=model, d=d, ros1=ros1)
    for name, value in names.items():
        setattr(message, name.upper() if ros1 else name, value)
    reading = decode_camera_info(message)
    calibration = reading.calibration
    assert (calibration.model, calibration.d, reading.rectified) == ("none", (), True)
    assert calibration.k == (300.0, 0, 310.0, 0, 305.0, 230.0, 0, 0, 1)
    assert (calibration.r, calibration.p) == ((1, 0, 0, 0, 1, 0, 0, 0, 1), tuple(P))


def test_where_k_is_filled_in_p_does_not_count():
    reading = decode_camera_info(camera_info(d=FIVE, p=P))
    calibration = reading.calibration
    assert (calibration.k[0], calibration.d, reading.rectified) == (400.0, FIVE, False)


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"d": FIVE}, "K is all zeros, so nobody can tell what its D distorts"),
        ({"p": P * [1, 1, 3, 1, 1, 1, 1, 1, 1, 1, 1, 1]}, "principal point .* lies outside the image"),
        ({"p": P + 2.0 * np.eye(12)[1]}, "its camera matrix is not of the form"),
        ({"p": P * -1}, "P has no focal lengths"),
        ({"p": P * math.nan}, "R or P hold numbers that are not finite"),
        ({"width": 0, "height": 0}, "image size is 0x0"),
    ],
)
def test_nonsense_in_p_is_refused(changes, problem):
    message = camera_info(**({"p": P} | changes))
    message.k = np.zeros(9)
    with pytest.raises(DecodeError, match=problem):
        decode_camera_info(message)
