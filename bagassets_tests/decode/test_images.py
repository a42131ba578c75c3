"""Images of every encoding against known colours; compressed ones that are whole, padded or cut off."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from bagassets.assets.image_output import ImageOutput
from bagassets.base.errors import DecodeError
from bagassets.decode.compressed_image import checked_size, decode_compressed_image
from bagassets.decode.image import decode_image, demosaic, to_bgr_or_grey
from bagassets.geometry.calibration import CameraLens, RegionOfInterest
from bagassets.geometry.camera import CameraModel
from bagassets_tests.cameras import camera_use
from bagassets_tests.decoded_images import pixels_of

RGB = (200, 120, 40)
HEADER = SimpleNamespace(stamp=SimpleNamespace(sec=1, nanosec=2), frame_id="/cam")


def image(encoding, rows, *, step=None, big=0):
    height, width = rows.shape[:2]
    data = np.ascontiguousarray(rows).view(np.uint8).reshape(height, -1)
    step = step or data.shape[1]
    padded = np.zeros((height, step), np.uint8)
    padded[:, : data.shape[1]] = data
    return SimpleNamespace(
        header=HEADER,
        height=height,
        width=width,
        encoding=encoding,
        is_bigendian=big,
        step=step,
        data=padded.reshape(-1),
    )


def mosaic(pattern, dtype):
    colour = dict(zip("rgb", RGB, strict=True))
    cell = np.array(
        [[colour[pattern[0]], colour[pattern[1]]], [colour[pattern[2]], colour[pattern[3]]]], dtype
    )
    return np.tile(cell, (8, 8)) * (257 if dtype == np.uint16 else 1)


def bgr(message):
    reading = decode_image(message)
    return to_bgr_or_grey(reading.pixels, reading.encoding)


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
@pytest.mark.parametrize(("bits", "dtype"), [(8, np.uint8), (16, np.uint16)])
def test_bayer_patterns_give_the_true_colour(pattern, bits, dtype):
    pixels = bgr(image(f"bayer_{pattern}{bits}", mosaic(pattern, dtype)))
    assert pixels.dtype == dtype
    np.testing.assert_array_equal(pixels[8, 8], np.array(RGB[::-1]) * (257 if bits == 16 else 1))


@pytest.mark.parametrize(
    ("encoding", "pixel"),
    [
        ("rgb8", RGB),
        ("bgr8", RGB[::-1]),
        ("8UC3", RGB[::-1]),
        ("rgba8", (*RGB, 9)),
        ("bgra8", (*RGB[::-1], 9)),
    ],
)
@pytest.mark.parametrize("padding", [0, 5])
def test_colour_encodings(encoding, pixel, padding):
    rows = np.full((4, 6, len(pixel)), pixel, np.uint8)
    pixels = bgr(image(encoding, rows, step=6 * len(pixel) + padding))
    assert (pixels == RGB[::-1]).all()


@pytest.mark.parametrize(
    ("encoding", "order"), [("uyvy", (1, 0, 2, 0)), ("yuv422", (1, 0, 2, 0)), ("yuyv", (0, 1, 0, 2))]
)
def test_yuv_is_grey_where_chroma_is_neutral(encoding, order):
    values = [128 if component else 235 for component in order]
    rows = np.tile(np.array(values, np.uint8), (4, 3)).reshape(4, 6, 2)
    assert np.abs(bgr(image(encoding, rows)).astype(int) - 255).max() <= 1


@pytest.mark.parametrize("big", [0, 1])
@pytest.mark.parametrize("encoding", ["mono16", "16UC1"])
def test_16_bit_of_either_byte_order(encoding, big):
    rows = np.full((3, 5), 0x1234, ">u2" if big else "<u2")
    assert (bgr(image(encoding, rows, big=big)) == 0x1234).all()


def test_a_size_that_does_not_fit_is_refused():
    message = image("rgb8", np.zeros((4, 6, 3), np.uint8))
    message.height = 5
    with pytest.raises(DecodeError, match="6x5 in rgb8 with step 18 does not fit 72 bytes"):
        decode_image(message)


@pytest.mark.parametrize(("width", "height", "size"), [(6, 4, 35), (6, 4, 42), (5, 4, 30), (6, 3, 24)])
def test_nv12_of_another_size_is_refused(width, height, size):
    """Where a board aligns the height, nothing says at which row the chroma begins."""
    message = image("nv12", np.zeros((height, width), np.uint8))
    message.data = np.zeros(size, np.uint8)
    with pytest.raises(
        DecodeError, match=f"{width}x{height} in nv12 with step {width} does not fit {size} bytes"
    ):
        decode_image(message)


@pytest.mark.parametrize("encoding", ["rgb8", "mono16"])
def test_the_padding_of_the_last_row_may_be_left_out(encoding):
    """Some drivers send no more than the pixels of the last row, though its step is longer."""
    wide = 3 if encoding == "rgb8" else 2
    rows = np.arange(4 * 6 * wide, dtype=np.uint8).reshape(4, 6, wide)
    whole = image(encoding, rows, step=6 * wide + 8)
    short = image(encoding, rows, step=6 * wide + 8)
    short.data = short.data[:-8]
    np.testing.assert_array_equal(decode_image(short).pixels, decode_image(whole).pixels)
    short.data = short.data[:-1]
    with pytest.raises(DecodeError, match="does not fit"):
        decode_image(short)


@pytest.mark.parametrize("encoding", ["rgb8", "mono16"])
def test_a_step_that_was_left_zero_is_that_of_rows_without_gaps(encoding):
    wide = 3 if encoding == "rgb8" else 2
    rows = np.arange(4 * 6 * wide, dtype=np.uint8).reshape(4, 6, wide)
    whole, zero = image(encoding, rows), image(encoding, rows)
    zero.step = 0
    np.testing.assert_array_equal(decode_image(zero).pixels, decode_image(whole).pixels)
    zero.data = np.append(
        zero.data, np.zeros(4, np.uint8)
    )  # rows with gaps, of which nothing tells the length
    with pytest.raises(DecodeError, match="with step 0 does not fit"):
        decode_image(zero)


@pytest.mark.parametrize(("field", "value"), [("width", 0), ("height", 0), ("step", 17)])
def test_an_image_without_width_height_or_room_for_a_row_is_refused(field, value):
    message = image("rgb8", np.zeros((4, 6, 3), np.uint8))
    setattr(message, field, value)
    with pytest.raises(DecodeError, match="does not fit"):
        decode_image(message)


def test_an_unknown_bayer_pattern_is_named():
    with pytest.raises(DecodeError, match="Bayer pattern 'bayer_rgbg8' is not known"):
        demosaic(np.zeros((4, 4), np.uint8), "bayer_rgbg8")


def test_an_unknown_encoding_is_named():
    with pytest.raises(DecodeError, match="'rgb32f'"):
        decode_image(image("rgb32f", np.zeros((2, 2), np.uint8)))


def compressed(data, said="jpeg"):
    return SimpleNamespace(header=HEADER, format=said, data=np.frombuffer(data, np.uint8))


JPEG = cv2.imencode(".jpg", np.full((24, 40, 3), 90, np.uint8))[1].tobytes()
PNG = cv2.imencode(".png", np.full((24, 40), 7, np.uint16))[1].tobytes()


@pytest.mark.parametrize(("data", "kind"), [(JPEG, "jpeg"), (PNG, "png"), (JPEG + bytes(20_000), "jpeg")])
def test_the_type_is_found_from_the_bytes(data, kind):
    reading = decode_compressed_image(compressed(data, ""))
    assert reading.encoding == kind
    assert reading.encoded == data
    assert checked_size(data, kind) == (40, 24)


def test_bytes_that_are_no_image_are_refused():
    with pytest.raises(DecodeError, match="format 'jpeg' is neither JPEG nor PNG"):
        decode_compressed_image(compressed(b"nothing known"))


# --- what `format` says of the pixels inside, as image_transport's publisher writes it --------


def published(rgb, said):
    """A message as image_transport makes it: RGB or BGR is handed to an encoder that takes it for BGR."""
    kind = "png" if "png" in said else "jpg"
    handed = (
        rgb if "rgb" in said.rpartition("compressed")[2] or said.endswith("compressed") else rgb[..., ::-1]
    )
    flags = [cv2.IMWRITE_JPEG_QUALITY, 100] if kind == "jpg" else []
    return compressed(cv2.imencode(f".{kind}", np.ascontiguousarray(handed), flags)[1].tobytes(), said)


def decoded(message):
    reading = decode_compressed_image(message)
    return pixels_of(reading.encoded, reading.encoding)


@pytest.mark.parametrize("kind", ["png", "jpeg"])
@pytest.mark.parametrize("before", ["rgb8; ", "bgr8; ", "bayer_rggb8; ", ""])
@pytest.mark.parametrize("inside", ["rgb8", "bgr8"])
def test_the_colour_order_that_format_names_counts(kind, before, inside):
    rows = np.full((16, 16, 3), RGB, np.uint8)
    pixels = decoded(published(rows, f"{before}{kind} compressed {inside}"))
    assert np.abs(pixels.astype(int) - RGB[::-1]).max() <= (2 if kind == "jpeg" else 0)


@pytest.mark.parametrize("kind", ["png", "jpeg"])
@pytest.mark.parametrize("camera", ["rgb8", "bgr8", "rgba8"])
def test_old_recordings_that_name_no_order_hold_rgb(kind, camera):
    pixels = decoded(published(np.full((16, 16, 3), RGB, np.uint8), f"{camera}; {kind} compressed"))
    assert np.abs(pixels.astype(int) - RGB[::-1]).max() <= (2 if kind == "jpeg" else 0)


@pytest.mark.parametrize(
    "said", ["", "png", "rgb8", "rgb8; png", "rgb8; png compressed bgr8", "mono8; png compressed "]
)
def test_other_texts_leave_the_file_as_a_viewer_shows_it(said):
    data = cv2.imencode(".png", np.full((4, 4, 3), RGB[::-1], np.uint8))[1].tobytes()
    assert (decoded(compressed(data, said)) == RGB[::-1]).all()


def test_16_bit_colours_and_alpha_are_put_in_order_too():
    deep = np.full((4, 4, 3), RGB, np.uint16) * 257
    pixels = decoded(published(deep, "rgb16; png compressed rgb16"))
    assert pixels.dtype == np.uint16
    assert (pixels == np.array(RGB[::-1]) * 257).all()
    data = cv2.imencode(".png", np.full((4, 4, 4), (*RGB, 9), np.uint8))[1].tobytes()
    assert (decoded(compressed(data, "rgba8; png compressed rgba8")) == RGB[::-1]).all()


@pytest.mark.parametrize(
    "said", ["mono16; png compressed ", "16UC1; png compressed", "mono16; png compressed mono16"]
)
def test_compressed_grey_stays_grey(said):
    assert (decoded(compressed(PNG, said)) == np.full((24, 40), 7, np.uint16)).all()


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
@pytest.mark.parametrize("ending", ["", " ", " bayer"])
def test_a_compressed_mosaic_gives_the_true_colour(pattern, ending):
    said = f"bayer_{pattern}8; png compressed{ending}" + (f"_{pattern}8" if ending.strip() else "")
    data = cv2.imencode(".png", mosaic(pattern, np.uint8))[1].tobytes()
    assert decoded(compressed(data, said))[8, 8].tolist() == list(RGB[::-1])


def test_a_bayer_camera_compressed_as_grey_is_grey():
    data = cv2.imencode(".png", np.full((4, 4), 9, np.uint8))[1].tobytes()
    assert (decoded(compressed(data, "bayer_rggb8; png compressed mono8")) == 9).all()


@pytest.mark.parametrize(
    ("said", "passed"),
    [
        ("bgr8; png compressed bgr8", True),
        ("rgb8; png compressed rgb8", False),
        ("bayer_rggb8; png compressed ", False),
    ],
)
def test_only_what_any_viewer_shows_right_passes_as_recorded(said, passed):
    use = camera_use("sensor_msgs/msg/CompressedImage", output="as_recorded")
    rows = mosaic("rggb", np.uint8) if "bayer" in said else np.full((16, 16, 3), RGB, np.uint8)
    message = (
        compressed(cv2.imencode(".png", rows)[1].tobytes(), said)
        if "bayer" in said
        else published(rows, said)
    )
    made = ImageOutput(use, None).make(decode_compressed_image(message))
    assert made.extension == ".png"
    assert (bytes(made.data) == message.data.tobytes()) == passed
    shown = cv2.imdecode(np.frombuffer(made.data, np.uint8), cv2.IMREAD_COLOR)
    assert shown[8, 8].tolist() == list(RGB[::-1])


LENSES = {
    "plumb_bob": (-0.2, 0.05, 0.001, -0.002, 0.01),
    "rational_polynomial": (0.1, -0.05, 0.001, -0.001, 0.01, 0.2, -0.02, 0.003),
    "equidistant": (0.02, -0.01, 0.003, -0.001),
}


@pytest.mark.parametrize("model", LENSES)
def test_projection_agrees_with_opencv(model):
    camera = CameraModel(model, 640, 480, 400.0, 410.0, 320.0, 240.0, LENSES[model])
    points = np.random.default_rng(1).uniform([-1, -0.8, 2], [1, 0.8, 5], (50, 3))
    d = np.array(LENSES[model])
    if model == "equidistant":
        truth, _ = cv2.fisheye.projectPoints(points[:, None], np.zeros(3), np.zeros(3), camera.matrix, d)
    else:
        truth, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), camera.matrix, d)
    pixels, in_front = camera.project(points)
    assert in_front.all()
    np.testing.assert_allclose(pixels, truth[:, 0], atol=1e-6)


@pytest.mark.parametrize("model", LENSES)
def test_undistortion_moves_points_to_where_a_pinhole_sees_them(model):
    camera = CameraModel(model, 640, 480, 400.0, 410.0, 320.0, 240.0, LENSES[model])
    pinhole = camera.undistorted()
    maps = camera.undistortion_maps(pinhole)
    for point in ([0.0, 0.0, 4.0], [1.2, -0.7, 4.0], [-1.0, 0.9, 4.0]):
        (u, v), _ = camera.project(np.array([point]))[0][0], None
        rows, columns = np.mgrid[0:480, 0:640]
        spot = 255 * np.exp(-((columns - u) ** 2 + (rows - v) ** 2) / 18)
        straight = cv2.remap(spot.astype(np.float32), maps[0], maps[1], cv2.INTER_LINEAR)
        centre = [(straight * axis).sum() / straight.sum() for axis in (columns, rows)]
        np.testing.assert_allclose(centre, pinhole.project(np.array([point]))[0][0], atol=0.3)


def test_region_and_binning_shift_and_scale_the_matrix():
    camera = CameraLens(
        model="none", width=800, height=600, k=(500.0, 0, 400, 0, 500, 300, 0, 0, 1), d=(), binning=(2, 2),
        roi=RegionOfInterest(100, 50, 600, 400, do_rectify=False),
    )  # fmt: skip
    model = CameraModel.from_calibration(camera)
    assert (model.width, model.height) == (300, 200)
    assert (model.fx, model.fy) == (250.0, 250.0)
    # Full-resolution pixel (400, 300) is ROI pixel (300, 250), which lies at (299.5 / 2, 249.5 / 2).
    assert (model.cx, model.cy) == (149.75, 124.75)
