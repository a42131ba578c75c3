"""What makes images fast changes none of their bytes, and costs no quality against the plain way."""

import resource
from functools import partial

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sample_drives import build_sample

from bagassets.assets.frames import _outlasts_the_call
from bagassets.decode.image import bayer_to_bgra, to_bgr_or_grey
from bagassets.engine.process import encoder_threads, encoders, keep_freed_memory
from bagassets.geometry.camera import CameraModel
from bagassets.geometry.undistortion import undistort
from bagassets.recordings.open import open_recording

PATTERNS = ["rggb", "bggr", "gbrg", "grbg"]


@settings(max_examples=60, deadline=None)
@given(st.integers(4, 90), st.integers(4, 70), st.sampled_from(PATTERNS), st.integers(0, 2**32 - 1))
def test_four_channels_give_the_bytes_of_three(width, height, pattern, seed):
    mosaic = np.random.default_rng(seed).integers(0, 256, (height, width), dtype=np.uint8)
    encoding = f"bayer_{pattern}8"
    lens = CameraModel("plumb_bob", width, height, width, width, width / 2, height / 2, (-0.3, 0.1, 0, 0, 0))
    maps = lens.undistortion_maps(lens.undistorted())
    three = undistort(to_bgr_or_grey(mosaic, encoding), maps)
    four = undistort(bayer_to_bgra(mosaic, encoding), maps)
    assert np.array_equal(four[..., :3], three)
    encode = partial(cv2.imencode, ".jpg", params=[cv2.IMWRITE_JPEG_QUALITY, 90])
    assert encode(four)[1].tobytes() == encode(three)[1].tobytes()


@pytest.mark.parametrize("encoding", ["mono8", "bgr8", "bayer_rggb16"])
def test_other_images_stay_as_they_are(encoding):
    assert bayer_to_bgra(np.zeros((4, 4), np.uint8), encoding) is None


def plain_way(message, lens):
    """Convert with floating-point maps, made for this very image, as a first script would."""
    if hasattr(message, "format"):
        image = cv2.imdecode(message.data, cv2.IMREAD_COLOR)
    else:
        rows = message.data.reshape(message.height, message.width, -1)
        code = cv2.COLOR_BayerBG2BGR if message.encoding.startswith("bayer") else cv2.COLOR_RGB2BGR
        image = cv2.cvtColor(rows, code)
    size = (lens.width, lens.height)
    distortion = np.array(lens.distortion)
    make = cv2.fisheye if lens.model == "equidistant" else cv2
    maps = make.initUndistortRectifyMap(lens.matrix, distortion, np.eye(3), lens.matrix, size, cv2.CV_32FC1)
    straight = cv2.remap(image, *maps, cv2.INTER_LINEAR)
    return cv2.imdecode(cv2.imencode(".jpg", straight, [cv2.IMWRITE_JPEG_QUALITY, 90])[1], cv2.IMREAD_COLOR)


def psnr_db(image, reference):
    error = np.mean((image.astype(float) - reference.astype(float)) ** 2)
    return 10 * np.log10(255**2 / error) if error else np.inf


def test_images_are_as_good_as_those_of_the_plain_way(tmp_path):
    built = build_sample(tmp_path, duration_s=1.0, targets=[("drive.bag", "ros1")])
    compared = 0
    with open_recording(tmp_path / "recordings" / "drive.bag") as recording:
        for camera in built.truth.cameras.values():
            topic = f"/{camera.name}/image_raw" + ("/compressed" if camera.encoding == "jpeg" else "")
            artifact = built.channel("drive.bag", "frames", camera.channel)
            for raw in recording.messages([topic]):
                message = recording.decode(raw)
                stamp_ns = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
                image = cv2.imread(str(artifact.path(f"{stamp_ns}.jpg")))
                assert psnr_db(image, plain_way(message, camera.model)) >= 45
                compared += 1
    assert compared == 30


def test_a_process_takes_no_more_threads_than_processors(monkeypatch):
    monkeypatch.setattr("os.sched_getaffinity", lambda _: set(range(3)))
    assert encoder_threads() == 3
    monkeypatch.setattr("os.sched_getaffinity", lambda _: set(range(64)))
    assert encoder_threads() == 8
    with encoders(1) as pool:
        assert pool is None


def test_memory_that_was_freed_is_used_again():
    keep_freed_memory()
    np.ones(6_000_000, np.uint8)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(20):
        np.ones(6_000_000, np.uint8)  # 1465 pages
    assert resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before < 1465


def test_only_buffers_that_are_used_again_are_copied():
    assert _outlasts_the_call(b"image")
    assert _outlasts_the_call(memoryview(b"chunk with an image")[2:7])
    assert not _outlasts_the_call(memoryview(bytearray(b"image")))
    assert not _outlasts_the_call(memoryview(np.zeros(5, np.uint8)))
