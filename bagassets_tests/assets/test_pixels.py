"""Pixels from a recording to the files of a build, against truth that is computed here.

Every pixel has a colour of its own, so that rows, columns, channels and byte orders cannot be confused. The truth
comes from the definitions of the encodings: ITU-R BT.601 for YUV, the colour filter for Bayer, the recipe's rule
for 16 bit. It uses neither OpenCV nor code of the package; OpenCV only opens the finished PNG files.
"""

from pathlib import Path

import cv2
import numpy as np
import pytest

from bagassets.engine.execute import BuildFailure
from bagassets.recipe import load_recipe
from bagassets.recordings.digest import recording_digest, recording_stat
from bagassets.recordings.discover import discover
from bagassets.store.store import Store
from bagassets_tests.recorded_bags import NOON_NS, Message, header, write_mcap, write_ros1
from bagassets_tests.recording_build import RecordingBuild

MS = 1_000_000
WIDTH, HEIGHT = 22, 14

RECIPE = """
name: pixels
bags: {root: bags, settle_s: 0}
limits: {lost_messages: 0.5}
rigs:
  - name: mast
    ego_pose: {source: fixed}
    channels:
      CAM_FRONT:
        {modality: camera, topic: /cam, undistort: false, extrinsics: {translation: [0, 0, 1], rotation: [1, 0, 0, 0]}, RULES}
"""


def raw(number, encoding, rows, *, big=0, padding=0, height=None):
    """An `Image` from an array whose rows are lines of the image; `height` of them, if others lie below."""
    lines = np.ascontiguousarray(rows).view(np.uint8).reshape(rows.shape[0], -1)
    padded = np.pad(lines, ((0, 0), (0, padding)), constant_values=77)

    def make(store):
        kind = store.types["sensor_msgs/msg/Image"]
        stamp = header(store, NOON_NS + number * 100 * MS, "cam")
        lines, width = rows.shape[:2]
        return kind(stamp, height or lines, width, encoding, big, padded.shape[1], padded.reshape(-1))

    return Message("/cam", "sensor_msgs/msg/Image", NOON_NS + number * 100 * MS, make)


def compressed(number, said, extension, pixels, *options):
    """A `CompressedImage` of BGR or grey pixels."""
    data = cv2.imencode(extension, pixels, options)[1]

    def make(store):
        stamp = header(store, NOON_NS + number * 100 * MS, "cam")
        return store.types["sensor_msgs/msg/CompressedImage"](stamp, said, data)

    return Message("/cam", "sensor_msgs/msg/CompressedImage", NOON_NS + number * 100 * MS, make)


def built(folder, messages, rules="output: png", write=write_ros1):
    """Return the pixels of the files that a build makes of a recording: grey, or RGB."""
    frames = frames_of(folder, messages, rules, write)
    images = [cv2.imread(str(path), cv2.IMREAD_UNCHANGED) for path in files_of(frames)]
    return [image if image.ndim == 2 else image[..., ::-1] for image in images]


def files_of(frames):
    """Return the image files of the channel in order of time."""
    return [Path(frames.path(row["file"])) for row in frames.read_table("index.parquet").to_pylist()]


def frames_of(folder, messages, rules, write=write_ros1):
    """Return the artifact of the channel."""
    (folder / "bags").mkdir(parents=True)
    write(folder / "bags" / ("a.mcap" if write is write_mcap else "a.bag"), messages)
    (folder / "recipe.yaml").write_text(RECIPE.replace("RULES", rules))
    recipe = load_recipe(folder / "recipe.yaml")
    (recording,) = discover(recipe.bags).recordings.values()
    store = Store(recipe.store_path)
    build = RecordingBuild(
        recipe, store, recording, recording_digest(recording).digest, recording_stat(recording)
    )
    *_, frames = build.build(["inventory", "calibration", "frames"])
    return store.artifact(frames.channels["CAM_FRONT"])


def coloured(channels=3):
    """(H, W, channels) of uint8 in which no two pixels and no two channels are alike."""
    rows, columns = np.mgrid[0:HEIGHT, 0:WIDTH]
    planes = [columns * 11 + rows, rows * 17 + columns // 2, 255 - columns * 5 - rows * 3, rows * 7 + columns]
    return np.stack([plane.astype(np.uint8) for plane in planes[:channels]], axis=-1)


@pytest.mark.parametrize("write", [write_ros1, write_mcap])
@pytest.mark.parametrize("padding", [0, 6])
@pytest.mark.parametrize(
    ("encoding", "order"),
    [
        ("rgb8", [0, 1, 2]),
        ("bgr8", [2, 1, 0]),
        ("8UC3", [2, 1, 0]),
        ("rgba8", [0, 1, 2, 3]),
        ("bgra8", [2, 1, 0, 3]),
    ],
)
def test_colours_of_every_pixel(tmp_path, encoding, order, padding, write):
    rgba = coloured(4)
    (image,) = built(tmp_path, [raw(0, encoding, rgba[..., order], padding=padding)], write=write)
    np.testing.assert_array_equal(image, rgba[..., :3])


@pytest.mark.parametrize("encoding", ["mono8", "8UC1"])
def test_grey_stays_as_it_is(tmp_path, encoding):
    grey = coloured(1)[..., 0]
    (image,) = built(tmp_path, [raw(0, encoding, grey, padding=3)])
    np.testing.assert_array_equal(image, grey)


def bt601(y, u, v):
    """RGB of ITU-R BT.601 with 16 to 235 for black to white."""
    luma = 255 / 219 * (y - 16.0)
    red = luma + 255 / 224 * 1.402 * (v - 128.0)
    blue = luma + 255 / 224 * 1.772 * (u - 128.0)
    green = (luma - 0.299 * red - 0.114 * blue) / 0.587
    return np.clip(np.stack([red, green, blue], axis=-1), 0, 255)


# name -> places of (first luma, Cb, second luma, Cr) in the four bytes of two pixels
PACKED = {"yuv422": (1, 0, 3, 2), "uyvy": (1, 0, 3, 2), "yuv422_yuy2": (0, 1, 2, 3), "yuyv": (0, 1, 2, 3)}


@pytest.mark.parametrize("encoding", PACKED)
def test_yuv_has_the_colours_of_bt_601(tmp_path, encoding):
    rows, pairs = np.mgrid[0:HEIGHT, 0 : WIDTH // 2]
    first, second = 40 + pairs * 9 + rows * 5, 60 + pairs * 4 + rows * 8
    # Cb and Cr each go from one end to the other, in different directions.
    cb, cr = 20 + pairs * 20, 230 - rows * 15
    packed = np.zeros((HEIGHT, WIDTH // 2, 4), np.uint8)
    for place, plane in zip(PACKED[encoding], (first, cb, second, cr), strict=True):
        packed[..., place] = plane
    truth = np.stack([bt601(first, cb, cr), bt601(second, cb, cr)], axis=2).reshape(HEIGHT, WIDTH, 3)
    assert np.abs(truth[..., 0] - truth[..., 2]).max() > 200, "red and blue must not be alike"
    (image,) = built(tmp_path, [raw(0, encoding, packed.reshape(HEIGHT, WIDTH, 2), padding=4)])
    assert np.abs(image - truth).max() <= 1.5


@pytest.mark.parametrize("encoding", ["nv12", "NV21"])
@pytest.mark.parametrize("padding", [0, 4])
def test_chroma_below_the_luma_has_the_colours_of_bt_601(tmp_path, encoding, padding):
    """The size is that of the picture, so the data is half as long again as its rows."""
    rows, columns = np.mgrid[0:HEIGHT, 0:WIDTH]
    luma = (40 + columns * 4 + rows * 5).astype(np.uint8)
    cb, cr = 20 + columns[::2, ::2] * 10, 230 - rows[::2, ::2] * 7
    pairs = (cb, cr) if encoding == "nv12" else (cr, cb)
    chroma = np.stack(pairs, axis=-1).astype(np.uint8).reshape(HEIGHT // 2, WIDTH)
    both = (np.repeat(np.repeat(one, 2, axis=0), 2, axis=1) for one in (cb, cr))
    truth = bt601(luma, *both)
    assert np.abs(truth[..., 0] - truth[..., 2]).max() > 200, "red and blue must not be alike"
    (image,) = built(tmp_path, [raw(0, encoding, np.vstack([luma, chroma]), padding=padding, height=HEIGHT)])
    assert np.abs(image - truth).max() <= 1.5


@pytest.mark.parametrize(("colour", "yuv"), [((255, 0, 0), (81, 90, 240)), ((0, 0, 255), (41, 240, 110))])
def test_pure_red_and_blue_in_yuv(tmp_path, colour, yuv):
    y, u, v = yuv
    rows = np.tile(np.array([u, y, v, y], np.uint8), (HEIGHT, WIDTH // 2)).reshape(HEIGHT, WIDTH, 2)
    (image,) = built(tmp_path, [raw(0, "uyvy", rows)])
    assert np.abs(image.astype(int) - colour).max() <= 2


# Four areas, each of one colour, far apart in every channel.
AREAS = np.array([[(220, 30, 90), (20, 200, 60)], [(40, 80, 240), (150, 10, 170)]])


def areas(scale=1):
    """(H, W, 3) RGB of four areas, and which pixels lie so deep inside one that all their neighbours do, too."""
    rows, columns = np.mgrid[0:HEIGHT, 0:WIDTH]
    low, right = rows >= HEIGHT // 2, columns >= WIDTH // 2
    inside = (np.minimum(np.abs(rows - HEIGHT // 2 + 0.5), np.abs(columns - WIDTH // 2 + 0.5)) > 2) & (
        (rows > 1) & (rows < HEIGHT - 2) & (columns > 1) & (columns < WIDTH - 2)
    )
    return AREAS[low.astype(int), right.astype(int)] * scale, inside


def filtered(rgb, pattern, dtype):
    """What a sensor sees behind a colour filter; the pattern names the first two pixels of the first two rows."""
    mosaic = np.zeros(rgb.shape[:2], dtype)
    for place, colour in enumerate(pattern):
        row, column = divmod(place, 2)
        mosaic[row::2, column::2] = rgb[row::2, column::2, "rgb".index(colour)]
    return mosaic


PATTERNS = ("rggb", "bggr", "gbrg", "grbg")


@pytest.mark.parametrize("pattern", PATTERNS)
def test_bayer_8_bit(tmp_path, pattern):
    rgb, inside = areas()
    (image,) = built(tmp_path, [raw(0, f"bayer_{pattern}8", filtered(rgb, pattern, np.uint8), padding=2)])
    np.testing.assert_array_equal(image[inside], rgb[inside])


@pytest.mark.parametrize("big", [0, 1])
@pytest.mark.parametrize("pattern", PATTERNS)
def test_bayer_16_bit(tmp_path, pattern, big):
    rgb, inside = areas(257)
    mosaic = filtered(rgb, pattern, ">u2" if big else "<u2")
    (image,) = built(tmp_path, [raw(0, f"bayer_{pattern}16", mosaic, big=big)])
    assert image.dtype == np.uint16
    np.testing.assert_array_equal(image[inside], rgb[inside])


@pytest.mark.parametrize("pattern", PATTERNS)
@pytest.mark.parametrize(
    "said",
    ["bayer_{}8; png compressed bayer_{}8", "bayer_{}8; png compressed ", "bayer_{}8"],
    ids=["inside", "empty", "alone"],
)
def test_bayer_in_a_png_is_demosaiced(tmp_path, pattern, said):
    rgb, inside = areas()
    mosaic = filtered(rgb, pattern, np.uint8)
    (image,) = built(tmp_path, [compressed(0, said.format(pattern, pattern), ".png", mosaic)])
    np.testing.assert_array_equal(image[inside], rgb[inside])


@pytest.mark.parametrize("pattern", PATTERNS)
def test_16_bit_bayer_in_a_png_is_demosaiced(tmp_path, pattern):
    rgb, inside = areas(256)
    said = f"bayer_{pattern}16; png compressed bayer_{pattern}16"
    (image,) = built(tmp_path, [compressed(0, said, ".png", filtered(rgb, pattern, np.uint16))])
    assert image.dtype == np.uint16
    np.testing.assert_array_equal(image[inside], rgb[inside])


def test_bayer_in_a_jpeg_is_demosaiced(tmp_path):
    rgb = np.full((64, 64, 3), (180, 120, 60))
    said = "bayer_grbg8; jpeg compressed bayer_grbg8"
    mosaic = filtered(rgb, "grbg", np.uint8)
    (image,) = built(tmp_path, [compressed(0, said, ".jpg", mosaic, cv2.IMWRITE_JPEG_QUALITY, 100)])
    assert np.abs(image[2:-2, 2:-2].astype(int) - (180, 120, 60)).max() <= 3


@pytest.mark.parametrize("said", ["", "png", "rgb8; png compressed bgr8"])
def test_colours_in_a_png(tmp_path, said):
    rgb = coloured()
    (image,) = built(tmp_path, [compressed(0, said, ".png", rgb[..., ::-1])])
    np.testing.assert_array_equal(image, rgb)


def test_transparency_of_a_png_is_dropped(tmp_path):
    rgb = coloured()
    bgra = np.concatenate([rgb[..., ::-1], coloured(4)[..., 3:]], axis=-1)
    (image,) = built(tmp_path, [compressed(0, "png", ".png", bgra)])
    np.testing.assert_array_equal(image, rgb)


def deep(number, offset):
    """16-bit grey: a ramp from `offset`, in steps of 101."""
    return offset + 101 * np.arange(WIDTH * HEIGHT).reshape(HEIGHT, WIDTH) + number


@pytest.mark.parametrize("big", [0, 1])
@pytest.mark.parametrize("encoding", ["mono16", "16UC1"])
def test_16_bit_stays_16_bit_without_a_rule(tmp_path, encoding, big):
    grey = deep(0, 300)
    (image,) = built(tmp_path, [raw(0, encoding, grey.astype(">u2" if big else "<u2"), big=big, padding=2)])
    assert image.dtype == np.uint16
    np.testing.assert_array_equal(image, grey)


def scaled(grey, low, high):
    """`low` and what is below it becomes 0, `high` and what is above it 255, in between a straight line."""
    return [[round(min(max((int(v) - low) * 255 / (high - low), 0), 255)) for v in row] for row in grey]


def test_16_bit_becomes_8_bit_by_a_range(tmp_path):
    grey = deep(0, 300)
    (image,) = built(
        tmp_path, [raw(0, "mono16", grey.astype("<u2"))], "output: png, to_8bit: {range: [1000, 21000]}"
    )
    assert image.dtype == np.uint8
    assert (image.min(), image.max()) == (0, 255)
    np.testing.assert_array_equal(image, scaled(grey, 1000, 21000))


def test_16_bit_becomes_8_bit_by_percentiles_of_the_whole_recording(tmp_path):
    images = [deep(number, 2000 + 9000 * number) for number in range(3)]
    messages = [raw(number, "mono16", grey.astype("<u2")) for number, grey in enumerate(images)]
    made = built(tmp_path, messages, "output: png, to_8bit: {percentiles: [10, 80]}")
    # The smallest value that is not below a tenth, and four fifths, of all pixels of all images.
    values = sorted(int(value) for grey in images for value in grey.ravel())
    low, high = (values[-(-len(values) * share // 100) - 1] for share in (10, 80))
    for image, grey in zip(made, images, strict=True):
        assert image.dtype == np.uint8
        np.testing.assert_array_equal(image, scaled(grey, low, high))
    # One rule for all: the same grey value has the same brightness in each of them.
    assert made[0].max() < made[2].max() == 255


def test_16_bit_bayer_becomes_8_bit_by_a_range(tmp_path):
    rgb, inside = areas(257)
    mosaic = filtered(rgb, "gbrg", "<u2")
    (image,) = built(tmp_path, [raw(0, "bayer_gbrg16", mosaic)], "output: png, to_8bit: {range: [0, 65535]}")
    np.testing.assert_array_equal(image[inside], rgb[inside] // 257)


def test_a_jpeg_has_the_colours_too(tmp_path):
    rgb = np.zeros((64, 64, 3), np.uint8)
    rgb[:, :32], rgb[:, 32:] = (200, 40, 40), (30, 60, 210)
    (image,) = built(tmp_path, [raw(0, "rgb8", rgb)], "output: jpeg, quality: 95")
    assert np.abs(image[8:-8, 8:24].astype(int) - (200, 40, 40)).max() <= 6
    assert np.abs(image[8:-8, 40:-8].astype(int) - (30, 60, 210)).max() <= 6


@pytest.mark.parametrize("extension", [".png", ".jpg"])
def test_a_compressed_image_passes_as_recorded_byte_for_byte(tmp_path, extension):
    messages = [compressed(number, "", extension, coloured() // (number + 1)) for number in range(2)]
    frames = frames_of(tmp_path, messages, "output: as_recorded")
    recorded = [bytes(cv2.imencode(extension, coloured() // (number + 1))[1]) for number in range(2)]
    assert [path.read_bytes() for path in files_of(frames)] == recorded
    rows = frames.read_table("index.parquet").to_pylist()
    assert [(row["width"], row["height"], row["size"]) for row in rows] == [
        (WIDTH, HEIGHT, len(data)) for data in recorded
    ]
    assert [path.suffix for path in files_of(frames)] == [extension] * 2
    assert frames.read_json("channel.json")["fileformat"] == extension[1:]


def test_a_raw_image_that_is_to_stay_as_recorded_becomes_a_png_without_loss(tmp_path):
    rgb = coloured()
    (image,) = built(tmp_path, [raw(0, "rgb8", rgb)], "output: as_recorded")
    np.testing.assert_array_equal(image, rgb)


def test_16_bit_becomes_no_jpeg_without_a_rule(tmp_path):
    with pytest.raises(BuildFailure, match=r"CAM_FRONT \(/cam\): 16-bit images become JPEG only by a rule"):
        built(tmp_path, [raw(0, "mono16", deep(0, 300).astype("<u2"))], "output: jpeg")


def test_an_image_that_cannot_be_used_leaves_the_percentiles_of_the_others_alone(tmp_path):
    good = [raw(number, "mono16", deep(number, 2000).astype("<u2")) for number in (0, 2)]
    bad = raw(1, "mono16", deep(1, 60_000 - 101 * WIDTH * HEIGHT).astype("<u2"))
    with_bad = built(
        tmp_path / "one", [good[0], cut_short(bad), good[1]], "output: png, to_8bit: {percentiles: [0, 100]}"
    )
    without = built(tmp_path / "other", good, "output: png, to_8bit: {percentiles: [0, 100]}")
    assert len(with_bad) == 2
    np.testing.assert_array_equal(with_bad, without)


def cut_short(message):
    """The same image with fewer bytes than its size asks for."""

    def make(store):
        image = message.make(store)
        image.data = image.data[:-9]
        return image

    return Message(message.topic, message.msgtype, message.log_time_ns, make)


def test_grey_of_a_single_value_has_a_range(tmp_path):
    (image,) = built(
        tmp_path,
        [raw(0, "mono16", np.full((HEIGHT, WIDTH), 4711, "<u2"))],
        "output: png, to_8bit: {percentiles: [1, 99]}",
    )
    assert image.dtype == np.uint8
    assert (image == 0).all()
