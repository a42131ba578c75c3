"""Depth becomes 16-bit PNGs: raw 32FC1, and compressedDepth as compressed_depth_image_transport writes it."""

import json
import struct
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from bagassets.assets.frames import FrameExtractor
from bagassets.base.errors import DecodeError, LossLimitError, RecipeError
from bagassets.decode.compressed_image import decode_compressed_image
from bagassets.decode.rvl import decode_rvl
from bagassets.recordings.model import RawMessage
from bagassets.store.artifact import ArtifactWriter
from bagassets_tests.cameras import camera_use

IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
DEPTH_M = np.array([[0.5, 1.2344, 10.0], [np.nan, np.inf, -1.0], [0.0, 65.535, 65.6]], np.float32)
IN_MM = [[500, 1234, 10000], [0, 0, 0], [0, 65535, 0]]
HEADER = SimpleNamespace(stamp=SimpleNamespace(sec=5, nanosec=0), frame_id="cam")


def raw(depth=DEPTH_M, *, bigendian=False):
    height, width = depth.shape
    data = depth.astype(">f4" if bigendian else "<f4").tobytes()
    return SimpleNamespace(
        header=HEADER, height=height, width=width, encoding="32FC1", is_bigendian=bigendian, step=4 * width,
        data=np.frombuffer(data, np.uint8),
    )  # fmt: skip


def compressed(data, text):
    return SimpleNamespace(header=HEADER, format=text, data=np.frombuffer(data, np.uint8))


def png(pixels):
    return cv2.imencode(".png", pixels)[1].tobytes()


def inverse(depth_m, *, quantisation=100.0, farthest_m=100.0):
    """Quantise depth as compressed_depth_image_transport does (codec.cpp): near depth finely."""
    a = quantisation * (quantisation + 1.0)
    b = 1.0 - a / farthest_m
    there = np.isfinite(depth_m) & (depth_m > 0) & (depth_m < farthest_m)
    levels = np.where(there, a / np.where(there, depth_m, 1.0) + b, 0).astype(np.uint16)
    return struct.pack("<iff", 0, a, b) + png(levels)


def rvl(levels):
    """Compress levels as in Wilson's paper, pixel by pixel, behind their size."""
    digits = []

    def number(value):
        while value > 7:
            digits.append(value & 7 | 8)
            value >>= 3
        digits.append(value)

    flat, last, at = levels.ravel().tolist(), 0, 0
    while at < len(flat):
        zeros = next((k for k, level in enumerate(flat[at:]) if level), len(flat) - at)
        at += zeros
        run = next((k for k, level in enumerate(flat[at:]) if not level), len(flat) - at)
        number(zeros)
        number(run)
        for level in flat[at : at + run]:
            delta, last = level - last, level
            number(2 * delta if delta >= 0 else -2 * delta - 1)
        at += run
    digits += [0] * (-len(digits) % 8)
    words = [int("".join(f"{digit:x}" for digit in digits[k : k + 8]), 16) for k in range(0, len(digits), 8)]
    return struct.pack(f"<II{len(words)}I", levels.shape[1], levels.shape[0], *words)


NO_PARAMETERS = struct.pack("<iff", 0, 0.0, 0.0)


class Recorded:
    def __init__(self, message):
        self.message = message

    def decode(self, _message):
        return self.message


def written(folder, message, msgtype=IMAGE, **settings):
    """Return the image that is made of a message, and channel.json."""
    use = camera_use(msgtype, **({"output": "png"} | settings))
    extractor = FrameExtractor(use, Recorded(message), ArtifactWriter(folder / "a"))
    extractor.add(RawMessage("/cam", msgtype, 7, b""))
    summary = extractor.finish()
    (file,) = (folder / "a/files").glob("5000000000.*")
    channel = json.loads((folder / "a/files/channel.json").read_text())
    assert channel.get("depth") == summary.get("depth")
    return cv2.imread(str(file), cv2.IMREAD_UNCHANGED), channel


@pytest.mark.parametrize("bigendian", [False, True])
def test_metres_become_millimetres(tmp_path, bigendian):
    image, channel = written(tmp_path, raw(bigendian=bigendian))
    assert (image.dtype, image.tolist()) == (np.uint16, IN_MM)
    # NaN, infinity, a negative and a zero; 65.6 m are more than 16 bit hold.
    assert channel["depth"] == {"unit_m": 0.001, "without": 4, "out_of_range": 1}


def test_another_unit_is_that_of_the_recipe(tmp_path):
    image, channel = written(tmp_path, raw(), depth_unit_m=0.01)
    assert image.tolist() == [[50, 123, 1000], [0, 0, 0], [0, 6554, 6560]]
    assert channel["depth"] == {"unit_m": 0.01, "without": 4, "out_of_range": 0}


def test_depth_of_16_bit_stays_as_it_was(tmp_path):
    levels = np.array([[0, 1, 65535], [500, 1000, 2000]], np.uint16)
    message = compressed(NO_PARAMETERS + png(levels), "16UC1; compressedDepth png")
    image, channel = written(tmp_path, message, COMPRESSED)
    assert image.tolist() == levels.tolist()
    assert "depth" not in channel


def test_inverse_depth_is_what_was_quantised(tmp_path):
    truth = np.array([[0.4, 1.0, 2.5], [8.0, np.nan, 20.0]], np.float32)
    image, channel = written(tmp_path, compressed(inverse(truth), "32FC1; compressedDepth"), COMPRESSED)
    # A level is d^2 / A metres at a distance d.
    with np.errstate(invalid="ignore"):
        tolerance_mm = 1000 * truth**2 / 10100 + 1
        assert (np.abs(image - 1000 * truth) <= tolerance_mm)[np.isfinite(truth)].all()
    assert image[1, 1] == 0
    assert channel["depth"] == {"unit_m": 0.001, "without": 1, "out_of_range": 0}


def test_a_jpeg_of_depth_needs_a_rule(tmp_path):
    with pytest.raises(RecipeError, match="set `output: png` to keep 16 bit"):
        written(tmp_path, raw(), output="jpeg")


@pytest.mark.parametrize(
    ("data", "text", "reason"),
    [
        (b"\0" * 40, "16UC1; compressedDepth zip", "neither PNG by its first bytes nor RVL"),
        (struct.pack("<iff", 0, 1.0, 1.0) + png(np.zeros((2, 2), np.uint8)), "8UC1; compressedDepth png", "of '8UC1' is not supported"),
    ],
)  # fmt: skip
def test_other_depth_is_refused(data, text, reason):
    with pytest.raises(DecodeError, match=reason):
        decode_compressed_image(compressed(data, text))


def test_inverse_depth_of_8_bit_is_lost(tmp_path):
    data = struct.pack("<iff", 0, 1.0, 1.0) + png(np.zeros((2, 2), np.uint8))
    with pytest.raises(LossLimitError, match="not 16-bit grey"):
        written(tmp_path, compressed(data, "32FC1; compressedDepth png"), COMPRESSED)


def test_depth_that_is_cut_off_is_lost(tmp_path):
    with pytest.raises(LossLimitError, match="the PNG is cut off"):
        written(tmp_path, compressed(inverse(DEPTH_M)[:-30], "32FC1; compressedDepth"), COMPRESSED)


def levels_of(shape, seed=0):
    """Return a sloping wall with noise and holes, and a corner at the end of the range."""
    random = np.random.default_rng(seed)
    levels = np.linspace(700, 9000, shape[0] * shape[1]).astype(np.uint16).reshape(shape)
    levels += random.integers(0, 9, shape, np.uint16)
    levels[random.random(shape) < 0.1] = 0
    levels[shape[0] // 2 :, : shape[1] // 3] = 0
    levels[0, 0] = 65535
    return levels


@pytest.mark.parametrize(
    "levels",
    [
        levels_of((48, 64)),
        np.zeros((5, 7), np.uint16),
        np.full((3, 5), 65535, np.uint16),
        np.random.default_rng(1).integers(0, 65536, (9, 11)).astype(np.uint16),
        np.array([[7]], np.uint16),
    ],
    ids=["a wall", "nothing", "far", "noise", "a pixel"],
)
def test_depth_in_rvl_stays_as_it_was(tmp_path, levels):
    message = compressed(NO_PARAMETERS + rvl(levels), "16UC1; compressedDepth rvl")
    image, channel = written(tmp_path, message, COMPRESSED)
    assert (image.dtype, image.tolist()) == (np.uint16, levels.tolist())
    assert "depth" not in channel


def test_rvl_of_another_encoder():
    """What pyrvl 0.0.1, which wraps the code of the paper, makes of a row."""
    data = struct.pack("<II", 8, 1) + bytes.fromhex("112c223400000000")
    assert decode_rvl(data).tolist() == [[0, 0, 0, 1, 2, 3, 9, 0]]


def test_inverse_depth_in_rvl_is_that_in_a_png(tmp_path):
    truth = np.array([[0.4, 1.0, 2.5], [8.0, np.nan, 20.0]], np.float32)
    as_png = inverse(truth)
    quantised = cv2.imdecode(np.frombuffer(as_png[12:], np.uint8), cv2.IMREAD_UNCHANGED)
    message = compressed(as_png[:12] + rvl(quantised), "32FC1; compressedDepth rvl")
    image, channel = written(tmp_path / "rvl", message, COMPRESSED)
    expected, its = written(tmp_path / "png", compressed(as_png, "32FC1; compressedDepth png"), COMPRESSED)
    assert image.tolist() == expected.tolist()
    assert channel["depth"] == its["depth"]


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (rvl(levels_of((48, 64)))[:-400], "the RVL is cut off"),
        (rvl(levels_of((48, 64)))[:7], "the RVL is cut off"),
        (struct.pack("<II", 64, 0), "the RVL has no pixels"),
        (struct.pack("<II", 64, 20) + rvl(levels_of((48, 64)))[8:], "more pixels than its size says"),
        (struct.pack("<II", 64, 48) + b"\xff" * 400 + bytes(4), "a number of more than 32 bit"),
        (struct.pack("<II", 60_000, 60_000) + bytes(64), "limits"),
    ],
    ids=["cut", "size cut", "no pixels", "smaller", "no number", "huge"],
)
def test_damaged_rvl_is_lost(tmp_path, data, reason):
    with pytest.raises(LossLimitError, match=reason):
        written(tmp_path, compressed(NO_PARAMETERS + data, "16UC1; compressedDepth rvl"), COMPRESSED)
