"""16-bit grey becomes 8 bit by one rule for the whole recording, and no topic is read more often for it."""

import resource
import signal
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from bagassets.assets.frames import FrameExtractor
from bagassets.assets.grey_survey import GreySurvey
from bagassets.base.errors import DecodeError, StoreError
from bagassets.recipe.model import GreyRange
from bagassets.recordings.model import RawMessage
from bagassets.store.artifact import ArtifactWriter
from bagassets_tests.cameras import IMAGE, camera_use

RNG = np.random.default_rng(7)
IMAGES = [RNG.integers(200 * n, 3000 + 900 * n, (12, 16)).astype(np.uint16) for n in range(5)]


class Photos:
    """A recording of 16-bit images; it counts how often it is read."""

    def __init__(self):
        self.reads = Counter()

    def messages(self, topics):
        self.reads.update(topics)
        return iter(messages())

    def decode(self, message):
        data = bytes(message.data)
        if data == b"broken":
            raise DecodeError("it is broken")
        stamp = SimpleNamespace(sec=message.log_time_ns // 10**9, nanosec=0)
        return SimpleNamespace(
            header=SimpleNamespace(stamp=stamp, frame_id="cam"), height=12, width=16, encoding="mono16", is_bigendian=0,
            step=32, data=np.frombuffer(data, np.uint8),
        )  # fmt: skip


def messages(*, broken=()):
    """Messages in one buffer that is overwritten, as a reader that saves memory hands them out."""
    for number, image in enumerate(IMAGES, 1):
        data = b"broken" if number in broken else image.tobytes()
        buffer = bytearray(data)
        yield RawMessage("/cam", IMAGE, number * 10**9, memoryview(buffer))
        buffer[:] = bytes(len(data))


def converted(folder, rule, recording=None, *, pool=None, broken=(), lost_messages=0.0):
    use = camera_use(output="png", to_8bit=GreyRange(**rule), lost_messages=lost_messages)
    recording = recording or Photos()
    writer = ArtifactWriter(folder / "artifact")
    extractor = FrameExtractor(use, recording, writer, pool)
    for message in messages(broken=broken):
        extractor.add(message)
    summary = extractor.finish()
    images = {
        number: cv2.imread(
            str(folder / "artifact" / "files" / f"{number}000000000.png"), cv2.IMREAD_UNCHANGED
        )
        for number in range(1, 1 + len(IMAGES))
        if number not in broken
    }
    return SimpleNamespace(
        summary=summary, images=images, digest=writer.finish(summary), folder=folder / "artifact"
    )


def scaled(image, low, high):
    """What the rule says, in plain arithmetic."""
    return np.clip(np.rint((image.astype(float) - low) * 255.0 / (high - low)), 0, 255).astype(np.uint8)


def test_a_range_maps_its_ends_to_black_and_white(tmp_path):
    made = converted(tmp_path, {"range": (500.0, 4000.0)})
    for number, image in enumerate(IMAGES, 1):
        np.testing.assert_array_equal(made.images[number], scaled(image, 500, 4000))


@pytest.mark.parametrize(("low_percent", "high_percent"), [(1.0, 99.0), (0.0, 100.0), (25.0, 50.0)])
def test_percentiles_are_those_of_all_images_together(tmp_path, low_percent, high_percent):
    made = converted(tmp_path, {"percentiles": (low_percent, high_percent)})
    values = np.sort(np.concatenate([image.ravel() for image in IMAGES]))
    # The smallest value that has this share of all at or below it.
    low, high = (
        int(values[max(0, int(np.ceil(percent / 100 * len(values))) - 1)])
        for percent in (low_percent, high_percent)
    )
    for number, image in enumerate(IMAGES, 1):
        np.testing.assert_array_equal(made.images[number], scaled(image, low, high))


def test_no_message_is_read_again_for_percentiles(tmp_path):
    recording = Photos()
    made = converted(tmp_path, {"percentiles": (1.0, 99.0)}, recording)
    assert recording.reads == {}
    assert made.summary["counts"] == {"read": 5, "written": 5, "merged": 0, "lost": {}}


def test_threads_make_no_difference(tmp_path):
    digests = set()
    for threads in (0, 1, 3):
        folder = tmp_path / str(threads)
        if threads:
            with ThreadPoolExecutor(threads) as pool:
                made = converted(folder, {"percentiles": (1.0, 99.0)}, pool=pool)
        else:
            made = converted(folder, {"percentiles": (1.0, 99.0)})
        digests.add(made.digest)
        # What was put aside leaves nothing behind.
        assert sorted(path.name for path in made.folder.iterdir()) == ["files", "manifest.json"]
    assert len(digests) == 1


def test_a_message_that_does_not_decode_is_lost_once(tmp_path):
    made = converted(tmp_path, {"percentiles": (1.0, 99.0)}, broken={2, 5}, lost_messages=0.5)
    assert made.summary["counts"] == {"read": 5, "written": 3, "merged": 0, "lost": {"it is broken": 2}}


def test_a_disk_that_refuses_is_named(tmp_path):
    with pytest.raises(StoreError, match=r"gone: 16-bit images cannot be stored there meanwhile.*`range`"):
        GreySurvey(tmp_path / "gone")


def test_a_disk_that_is_full_is_named(tmp_path):
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    survey = GreySurvey(tmp_path)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (100, limits[1]))
        message = next(messages())
        with pytest.raises(StoreError, match="16-bit images cannot be stored there meanwhile"):
            survey.add(message, None)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, ignored)
