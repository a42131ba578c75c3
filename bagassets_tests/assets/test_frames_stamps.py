"""Images whose header has no stamp: never a file of the year 1970, whichever of them comes first."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from bagassets.assets.frames import FrameExtractor
from bagassets.base.errors import LossLimitError
from bagassets.recordings.model import RawMessage
from bagassets.store.artifact import ArtifactWriter
from bagassets_tests.cameras import IMAGE, camera_use


class Photos:
    """A recording whose messages tell the seconds of their stamps."""

    def decode(self, message):
        stamp = SimpleNamespace(sec=int(message.data), nanosec=0)
        header = SimpleNamespace(stamp=stamp, frame_id="cam")
        return SimpleNamespace(
            header=header, height=4, width=6, encoding="mono8", is_bigendian=0, step=6, data=np.zeros(24, np.uint8)
        )  # fmt: skip


def extractor(folder, *seconds, clock="header", lost_messages=1.0):
    use = camera_use(clock=clock, lost_messages=lost_messages)
    made = FrameExtractor(use, Photos(), ArtifactWriter(folder / "a"))
    for number, stamp_s in enumerate(seconds, 7):
        made.add(RawMessage("/cam", IMAGE, number * 10**9, str(stamp_s).encode()))
    return made


@pytest.mark.parametrize("seconds", [(0,), (0, 0, 0), (0, 5, 6), (5, 0, 6)])
def test_an_image_without_stamp_is_lost_wherever_it_comes(tmp_path, seconds):
    counts = extractor(tmp_path, *seconds).finish()["counts"]
    written = len(seconds) - seconds.count(0)
    assert (counts["written"], counts["lost"]) == (written, {"zero stamp": seconds.count(0)})
    assert not (tmp_path / "a" / "files" / "0.jpg").exists()


def test_a_camera_without_stamps_asks_for_the_log_clock(tmp_path):
    made = extractor(tmp_path, 0, lost_messages=0.5)
    with pytest.raises(
        LossLimitError, match="lost 1 of 1 messages; the first: its header stamp is zero; set `clock: log`"
    ):
        made.finish()


def test_with_the_log_clock_stamps_do_not_matter(tmp_path):
    counts = extractor(tmp_path, 0, 0, clock="log").finish()["counts"]
    assert (counts["written"], counts["lost"]) == (2, {})
    assert (tmp_path / "a" / "files" / "7000000000.jpg").exists()


def test_of_images_with_one_stamp_the_first_is_written(tmp_path):
    counts = extractor(tmp_path, 5, 6, 5, 5).finish()["counts"]
    assert (counts["read"], counts["written"], counts["lost"]) == (4, 2, {"duplicate stamp": 2})


class Tape:
    """A recording whose messages are pixels in a buffer that is used again for the next one."""

    def __init__(self):
        self.buffer = bytearray(24)

    def message(self, second):
        self.buffer[:] = bytes([second]) * 24
        return RawMessage("/cam", IMAGE, second * 10**9, memoryview(self.buffer))

    def decode(self, message):
        pixels = np.frombuffer(message.data, np.uint8)
        header = SimpleNamespace(stamp=SimpleNamespace(sec=int(pixels[0]), nanosec=0), frame_id="cam")
        return SimpleNamespace(
            header=header, height=4, width=6, encoding="mono8", is_bigendian=0, step=6, data=pixels
        )  # fmt: skip


class LatePool:
    """Does what it is handed when its result is asked for, as threads may."""

    def submit(self, function, *args):
        return SimpleNamespace(result=lambda: function(*args))


def test_images_that_wait_for_a_thread_do_not_change_with_the_buffer_they_came_in(tmp_path):
    tape = Tape()
    made = FrameExtractor(camera_use(output="png"), tape, ArtifactWriter(tmp_path / "a"), LatePool())
    for second in range(1, 10):
        made.add(tape.message(second))
    assert made.finish()["counts"]["written"] == 9
    for second in range(1, 10):
        image = cv2.imread(str(tmp_path / "a" / "files" / f"{second}000000000.png"), cv2.IMREAD_UNCHANGED)
        assert (image == second).all()
