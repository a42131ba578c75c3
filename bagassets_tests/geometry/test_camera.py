"""Undistortion against world points: what is seen through a lens lands where a pinhole sees it.

The lenses are computed here from the formulas of sensor_msgs/CameraInfo and OpenCV, independently of
the package: a wall with a blurred dot at a world point is photographed pixel by pixel, and after
undistortion the centroid of the dot is where the written intrinsics put the point, within a twentieth
of a pixel.
"""

from functools import cache

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bagassets.assets.asset import Use
from bagassets.assets.frames import FRAMES
from bagassets.assets.image_output import ImageOutput, intrinsic_matrix
from bagassets.base.errors import CalibrationError
from bagassets.decode.camera_info import decode_camera_info
from bagassets.decode.model import ImageReading
from bagassets.geometry.calibration import CameraLens
from bagassets.geometry.camera import CameraModel
from bagassets.geometry.undistortion import Undistortion, undistort
from bagassets.recipe.model_calibration import PinholeIntrinsics
from bagassets_tests.cameras import camera_use
from bagassets_tests.pose_data import camera_info, region

WIDTH, HEIGHT = 640, 480
FX, FY, CX, CY = 380.0, 390.0, 327.0, 236.0
LENSES = {
    "plumb_bob": (-0.21, 0.06, 0.0012, -0.0021, 0.004),
    "rational_polynomial": (0.11, -0.05, 0.0009, -0.0011, 0.012, 0.35, -0.04, 0.003),
    "equidistant": (0.021, -0.011, 0.0031, -0.0012),
}
PRISM = (*LENSES["rational_polynomial"], 0.003, -0.001, -0.002, 0.0015)
TILTED = (*PRISM, 0.03, -0.02)
ALL_LENSES = [*LENSES.items(), ("rational_polynomial", PRISM), ("rational_polynomial", TILTED)]
RAYS = np.array([[x, y, 1.0] for x in (-0.55, -0.2, 0.17, 0.5) for y in (-0.4, -0.05, 0.36)]) * 4.0


def bend(model, d, x, y):
    """Where a lens puts the ray (x, y, 1), one formula at a time."""
    r = np.hypot(x, y)
    if model == "equidistant":
        theta = np.arctan(r)
        bent = theta + sum(k * theta ** (2 * i + 3) for i, k in enumerate(d))
        scale = np.divide(bent, r, out=np.ones_like(r), where=r > 0)
        return x * scale, y * scale
    k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4, tx, ty = (*d, *[0.0] * (14 - len(d)))
    radial = (1 + k1 * r**2 + k2 * r**4 + k3 * r**6) / (1 + k4 * r**2 + k5 * r**4 + k6 * r**6)
    x, y = (
        x * radial + 2 * p1 * x * y + p2 * (r**2 + 2 * x**2) + s1 * r**2 + s2 * r**4,
        y * radial + p1 * (r**2 + 2 * y**2) + 2 * p2 * x * y + s3 * r**2 + s4 * r**4,
    )
    turn_x = np.array([[1, 0, 0], [0, np.cos(tx), np.sin(tx)], [0, -np.sin(tx), np.cos(tx)]])
    turn_y = np.array([[np.cos(ty), 0, -np.sin(ty)], [0, 1, 0], [np.sin(ty), 0, np.cos(ty)]])
    turn = turn_y @ turn_x
    onto = np.array([[turn[2, 2], 0, -turn[0, 2]], [0, turn[2, 2], -turn[1, 2]], [0, 0, 1]])
    x, y, scale = np.tensordot(onto @ turn, np.stack([x, y, np.ones_like(x)]), 1)
    return x / scale, y / scale


@cache
def rays(model, d):
    """The ray (x, y, 1) of each pixel, by undoing `bend` iteratively."""
    rows, columns = np.mgrid[0:HEIGHT, 0:WIDTH]
    bent_x, bent_y = (columns - CX) / FX, (rows - CY) / FY
    x, y = bent_x, bent_y
    for _ in range(30):
        again_x, again_y = bend(model, d, x, y)
        x, y = x + bent_x - again_x, y + bent_y - again_y
    return x, y


def photograph(model, d, point, *, crop=(0, 0, WIDTH, HEIGHT), binning=(1, 1)):
    """A dot on a wall as the sensor records it: the region is cut out, then pixels are averaged."""
    x, y = rays(model, d)
    blur = 2.5 * max(binning) / FX
    dot = 60_000 * np.exp(-((x - point[0] / point[2]) ** 2 + (y - point[1] / point[2]) ** 2) / (2 * blur**2))
    x, y, width, height = crop
    bx, by = binning
    width, height = width // bx * bx, height // by * by
    part = dot[y : y + height, x : x + width].reshape(height // by, by, width // bx, bx)
    return part.mean(axis=(1, 3)).round().astype(np.uint16)


def calibration(message):
    """What of a calibration the step `frames` is handed."""
    lens = decode_camera_info(message).calibration
    return CameraLens(
        model=lens.model, width=lens.width, height=lens.height, k=lens.k, d=lens.d, binning=lens.binning, roi=lens.roi,
    )  # fmt: skip


def output(message, *, target=None, undistort=True):
    pinhole = None if target is None else PinholeIntrinsics(**target)
    use = camera_use(output="png", undistort=undistort, target=pinhole, camera=calibration(message))
    return ImageOutput(use, None)


def info(model, d, **changes):
    return camera_info(model=model, d=d, k=(FX, FY, CX, CY), width=WIDTH, height=HEIGHT, **changes)


def centroid(image):
    weights = image.astype(np.float64)
    rows, columns = np.mgrid[0 : image.shape[0], 0 : image.shape[1]]
    return np.array([(weights * columns).sum(), (weights * rows).sum()]) / weights.sum()


def assert_dots_are_where_the_pinhole_sees_them(made, model, d, points, **recorded):
    k = np.array(intrinsic_matrix(made.written))
    checked = 0
    for point in points:
        expected = (k @ (point / point[2]))[:2]
        size = np.array([made.written.width, made.written.height])
        image = photograph(model, d, point, **recorded)
        margin = 14
        if (expected < margin).any() or (expected > size - 1 - margin).any() or image.max() < 50_000:
            continue  # the dot is cut off by the border of one of the two images
        if min(image[0].max(), image[-1].max(), image[:, 0].max(), image[:, -1].max()) > 0:
            continue
        reading = ImageReading(1, "cam", image, None, "mono16")
        written = cv2.imdecode(np.frombuffer(made.make(reading).data, np.uint8), cv2.IMREAD_UNCHANGED)
        np.testing.assert_allclose(centroid(written), expected, atol=0.05)
        checked += 1
    assert checked >= 3


@pytest.mark.parametrize("model", LENSES)
def test_undistortion_of_the_whole_image(model):
    message = info(model, LENSES[model])
    assert_dots_are_where_the_pinhole_sees_them(output(message), model, LENSES[model], RAYS)


@pytest.mark.parametrize("model", LENSES)
def test_undistortion_with_other_intrinsics(model):
    target = {"fx": 250.0, "fy": 260.0, "cx": 300.5, "cy": 250.25}
    made = output(info(model, LENSES[model]), target=target)
    assert intrinsic_matrix(made.written) == [[250.0, 0, 300.5], [0, 260.0, 250.25], [0, 0, 1]]
    assert_dots_are_where_the_pinhole_sees_them(made, model, LENSES[model], RAYS)


@pytest.mark.parametrize("model", LENSES)
@pytest.mark.parametrize("crop", [(0, 0, WIDTH, HEIGHT), (90, 30, 512, 400), (51, 47, 560, 421)])
@pytest.mark.parametrize("binning", [(1, 1), (2, 2), (1, 2)])
def test_undistortion_of_a_region_that_is_binned(model, crop, binning):
    x, y, width, height = crop
    message = info(
        model, LENSES[model], roi=region(x, y, width, height), binning_x=binning[0], binning_y=binning[1]
    )
    made = output(message)
    assert (made.written.width, made.written.height) == (width // binning[0], height // binning[1])
    assert_dots_are_where_the_pinhole_sees_them(
        made, model, LENSES[model], RAYS[::2], crop=crop, binning=binning
    )


@pytest.mark.parametrize("d", [PRISM, TILTED])
def test_undistortion_of_thin_prisms_and_tilted_sensors(d):
    message = info("rational_polynomial", d)
    assert_dots_are_where_the_pinhole_sees_them(output(message), "rational_polynomial", d, RAYS)


def test_an_equidistant_lens_without_coefficients_still_bends():
    """Its image is not a pinhole's: at 30 degrees it is 10 % smaller."""
    message = info("equidistant", (0.0,) * 4)
    made = output(message)
    assert made.written.model == "none"
    assert_dots_are_where_the_pinhole_sees_them(made, "equidistant", (0.0,) * 4, RAYS)


def test_other_intrinsics_without_distortion():
    target = {"fx": 300.0, "fy": 300.0, "cx": 320.0, "cy": 240.0}
    made = output(info("plumb_bob", (0.0,) * 5), target=target)
    assert_dots_are_where_the_pinhole_sees_them(made, "none", (), RAYS)


def test_an_image_that_is_not_undistorted_keeps_its_pixels():
    made = output(info("plumb_bob", LENSES["plumb_bob"]), undistort=False)
    image = photograph("plumb_bob", LENSES["plumb_bob"], RAYS[0])
    data = made.make(ImageReading(1, "cam", image, None, "mono16")).data
    np.testing.assert_array_equal(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED), image)


@settings(deadline=None)
@given(
    st.sampled_from(ALL_LENSES),
    st.floats(-0.6, 0.6),
    st.floats(-0.45, 0.45),
    st.floats(0.5, 80.0),
)
def test_projection_agrees_with_the_formulas(lens, x, y, depth):
    model, d = lens
    camera = CameraModel(model, WIDTH, HEIGHT, FX, FY, CX, CY, d)
    point = np.array([x, y, 1.0]) * depth + [1e-9, 0, 0]
    pixels, in_front = camera.project(point[None])
    assert in_front.all()
    bent_x, bent_y = bend(model, d, *(point[:2] / point[2]))
    np.testing.assert_allclose(pixels[0], [FX * bent_x + CX, FY * bent_y + CY], atol=1e-7)
    _, behind = camera.project(-point[None])
    assert not behind.any()


@pytest.mark.parametrize("model", LENSES)
def test_the_optical_axis_is_at_the_principal_point(model):
    camera = CameraModel(model, WIDTH, HEIGHT, FX, FY, CX, CY, LENSES[model])
    assert camera.project(np.array([[0.0, 0.0, 3.0]]))[0].tolist() == [[CX, CY]]


def test_an_image_of_another_size_is_refused():
    made = output(info("plumb_bob", LENSES["plumb_bob"]))
    image = np.zeros((240, 320), np.uint8)
    with pytest.raises(
        CalibrationError,
        match=r"CAM \(/cam\): the image at 2023-11-14T22:13:20\.007Z is 320x240, but the calibration is for 640x480; correct .*, or, if the size of images changes there, split",
    ):
        made.make(ImageReading(1_700_000_000_007_000_000, "cam", image, None, "mono8"))


def places(maps):
    """Where in the recorded image each pixel is looked up, in 32nds of a pixel."""
    xy, fraction = maps
    return xy.astype(int) * 32 + np.stack([fraction & 31, fraction >> 5], axis=-1)


@pytest.mark.parametrize("zoom", [1.0, 0.6])
@pytest.mark.parametrize(("model", "d"), ALL_LENSES)
def test_maps_hold_the_place_of_each_pixel_to_half_a_32nd(model, d, zoom):
    camera = CameraModel(model, WIDTH, HEIGHT, FX, FY, CX, CY, d)
    target = camera.undistorted((FX * zoom, FY * zoom, CX + 3.5, CY - 2.25))
    rows, columns = np.mgrid[0:HEIGHT, 0:WIDTH]
    x, y = bend(model, d, (columns - target.cx) / target.fx, (rows - target.cy) / target.fy)
    truth = np.stack([FX * x + CX, FY * y + CY], axis=-1)
    found = places(camera.undistortion_maps(target))
    assert np.abs(found / 32 - truth).max() <= 1 / 64 + 1e-9
    make = cv2.fisheye.initUndistortRectifyMap if model == "equidistant" else cv2.initUndistortRectifyMap
    size = (WIDTH, HEIGHT)
    theirs = places(make(camera.matrix, np.array(d), np.eye(3), target.matrix, size, cv2.CV_16SC2))
    apart = np.abs(found - theirs)
    assert apart.max() <= 1
    assert np.count_nonzero(apart) < 20


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_a_pixel_that_the_lens_sees_nowhere_is_black(dtype):
    camera = CameraModel(
        "rational_polynomial", 640, 480, 500.0, 500.0, 320.0, 240.0, (0.5, 0, 0, 0, 0.5, -0.01, 0, 0)
    )
    target = camera.undistorted((30.0, 30.0, 320.0, 240.0))  # at r = 10 the lens divides by zero
    rows, columns = np.mgrid[0:480, 0:640]
    with np.errstate(divide="ignore", invalid="ignore"):
        x, y = bend("rational_polynomial", camera.distortion, (columns - 320) / 30, (rows - 240) / 30)
    u, v = 500 * x + 320, 500 * y + 240
    outside = ~((u > -1) & (u < 640) & (v > -1) & (v < 480))
    assert (np.abs(u) > 65_536).any()
    assert np.isnan(v).any() or np.isinf(u).any()
    white = np.full((480, 640, 3), 255, dtype)
    written = Undistortion(camera, target)(white)
    assert written[~outside].any()
    assert not written[outside].any()


@settings(deadline=None, max_examples=20)
@given(st.integers(0, 2**32 - 1), st.sampled_from(["uint8", "uint16"]), st.sampled_from(list(LENSES)))
def test_pixels_are_mixed_exactly_and_rounded_half_up(seed, dtype, model):
    """Truth in integers: the maps hold places in 1/32 pixel, so that weights are 1/1024."""
    rng = np.random.default_rng(seed)
    image = rng.integers(0, 256 if dtype == "uint8" else 65_536, (40, 60), dtype=dtype)
    camera = CameraModel(model, 60, 40, 45.0, 44.0, 30.5, 19.0, LENSES[model])
    places, fractions = maps = camera.undistortion_maps(camera.undistorted())
    room = 100
    padded = np.pad(image.astype(np.int64), room)
    x, y = places[..., 0].astype(int) + room, places[..., 1].astype(int) + room
    fx, fy = (fractions & 31).astype(int), (fractions >> 5).astype(int)
    mixed = (
        padded[y, x] * (32 - fx) * (32 - fy)
        + padded[y, x + 1] * fx * (32 - fy)
        + padded[y + 1, x] * (32 - fx) * fy
        + padded[y + 1, x + 1] * fx * fy
    )
    written = undistort(image, maps)
    assert written.dtype == image.dtype
    # OpenCV's 8-bit tables round the weights a little, but in integers, the same everywhere.
    tolerance = 0 if dtype == "uint16" else 1
    assert np.abs(written.astype(int) - ((mixed + 512) >> 10)).max() <= tolerance


@pytest.mark.parametrize(
    ("model", "d", "changes", "version"),
    [
        ("plumb_bob", (-0.1, 0.0, 0.0, 0.0), {}, 6),
        ("equidistant", (0.0,) * 4, {}, 6),
        ("plumb_bob", (0.0,) * 5, {}, 5),
        ("plumb_bob", (0.0,) * 5, {"target": {"fx": 300.0, "fy": 300.0, "cx": 320.0, "cy": 240.0}}, 6),
        ("plumb_bob", (-0.1, 0.0, 0.0, 0.0), {"undistort": False}, 5),
    ],
)
def test_only_images_that_are_looked_up_through_maps_are_made_again(model, d, changes, version):
    """The maps are now the same on every processor; copies of recorded files are none of their business."""
    changes = {"undistort": True} | changes
    if "target" in changes:
        changes["target"] = PinholeIntrinsics(**changes["target"])
    use = camera_use(output="png", camera=calibration(info(model, d)), **changes)
    assert FRAMES.action(Use(use), None).version == version
    assert FRAMES.version == 6
