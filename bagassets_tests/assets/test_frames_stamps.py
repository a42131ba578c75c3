"""Images whose header has no stamp: never a file of the year 1970, whichever of them comes first."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from bagassets.assets.frames import FrameExtractor
from bagassets.base.errors import LossLimitError
from bagassets.engine.execute import BuildFailure
from bagassets.recipe import load_recipe
from bagassets.recordings.digest import recording_stat
from bagassets.recordings.discover import discover
from bagassets.recordings.model import RawMessage
from bagassets.store.artifact import ArtifactWriter
from bagassets.store.store import Store
from bagassets_tests.cameras import IMAGE, camera_use
from bagassets_tests.recording_build import RecordingBuild
from bagassets_tests.small_drive import RECIPE, START_NS, STORE1, messages, write_messages


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


def images_of_drive(folder, stamp_ns, log_ns):
    """Build the images of a drive with other stamps and log times, given since its beginning; return their number."""

    def items():
        for topic, msgtype, at_ns, message in messages(STORE1, ros1=True):
            time_ns = at_ns - START_NS - 10_000_000 * topic.startswith("/cam")
            stamp = at_ns if topic == "/tf_static" else stamp_ns(time_ns)
            if topic != "/tf_static":
                message.header.stamp = type(message.header.stamp)(stamp // 10**9, stamp % 10**9)
            yield topic, msgtype, stamp, log_ns(max(time_ns, 0)) + 1, message

    write_messages(folder / "bags" / "a.bag", "ros1", STORE1, items())
    (folder / "recipe.yaml").write_text(RECIPE.format(name="x", root="bags"))
    recipe = load_recipe(folder / "recipe.yaml")
    recording = discover(recipe.bags).recordings["a.bag"]
    build = RecordingBuild(recipe, Store(recipe.store_path), recording, "0" * 64, recording_stat(recording))
    made = {one.asset: one for one in build.build({"inventory", "calibration", "frames"})}
    return made["frames"].artifact.read_json("channels.json")["CAM_FRONT"]["counts"]["written"]


@pytest.mark.parametrize("log_ns", [lambda t: t, lambda t: t + START_NS], ids=["simulated", "of the day"])
def test_stamps_of_a_simulation_begin_at_zero(log_ns, tmp_path):
    assert images_of_drive(tmp_path, lambda t: t, log_ns) == 29


@pytest.mark.parametrize(
    "stamp_ns",
    [lambda t: t % 2_000_000_000, lambda t: t + START_NS if t else 0, lambda _: 0],
    ids=["again in between", "not set at first", "never set"],
)
def test_other_stamps_of_zero_are_none(stamp_ns, tmp_path):
    with pytest.raises(BuildFailure, match="its header stamp is zero"):
        images_of_drive(tmp_path, stamp_ns, lambda t: t + START_NS)


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
