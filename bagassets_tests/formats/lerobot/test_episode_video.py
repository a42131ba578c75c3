"""Videos: exact times, no B-frames, the tagged matrix, and the same bytes on every processor."""

import os
import subprocess
import sys
from contextlib import suppress
from fractions import Fraction
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path

import av
import numpy as np
import pytest

from bagassets.base.errors import DatasetError
from bagassets.formats.lerobot import video
from bagassets.formats.lerobot.settings import Encoding
from bagassets.store.canonical import digest_bytes
from bagassets_tests import video_streams as busy
from bagassets_tests.painted_numbers import number_in, painted

H264 = video.with_defaults(Encoding())
AV1 = video.with_defaults(Encoding(codec="av1"))
BOTH = pytest.mark.parametrize("settings", [H264, AV1], ids=["h264", "av1"])

# Of the version in requirements.lock; others have other encoders in them.
GOLDEN = {
    "18.1.0": {
        "h264": "cb630cc289a694a8603e3cab31133d9d29960b1bf40526e4facd88f9e0a02c84",
        "av1": "41f0883480d99bb921feddf6b18a79e3c3cdecbfc54abc909ef3fde2c3042fae",
    }
}
MASKED = """
import ctypes, sys
from pathlib import Path
import av
if sys.argv[1] == "masked":
    library = next(Path(av.__file__).parent.parent.glob("av.libs/libavutil*"))
    ctypes.CDLL(str(library)).av_force_cpu_flags(0)
from bagassets.formats.lerobot import video
from bagassets.formats.lerobot.settings import Encoding
from bagassets_tests.formats.lerobot.test_episode_video import scene
settings = video.with_defaults(Encoding(codec=sys.argv[2]))
extra = ":asm=0" if sys.argv[1] == "masked" else ""
from bagassets.store.canonical import digest_bytes
print(digest_bytes(video.encode(scene(), 30, settings, extra)))
"""


def scene(number=16):
    """Images with noise, edges and motion, so that encoders have decisions to make."""
    chance = np.random.default_rng(7)
    still = chance.integers(0, 255, (30, 40, 3), dtype=np.uint8).repeat(8, 0).repeat(8, 1)
    for index in range(number):
        moved = np.roll(still, (3 * index, 2 * index), (0, 1)) // 2
        yield moved + chance.integers(0, 60, still.shape, dtype=np.uint8)


def decoded(path, **options):
    with av.open(str(path)) as container:
        return [
            (frame.pts * frame.time_base, frame.to_ndarray(format="rgb24", **options))
            for frame in container.decode(video=0)
        ]


@pytest.fixture(scope="module")
def films(tmp_path_factory):
    """Three videos of painted numbers: 0.., 100.., 200.."""
    folder = tmp_path_factory.mktemp("films")
    parts = []
    for part, frames in enumerate((7, 1, 12)):
        path = folder / f"{part}.mp4"
        path.write_bytes(video.encode((painted(100 * part + n) for n in range(frames)), 30, H264))
        parts.append((path, frames))
    return parts


class TestEncoding:
    @BOTH
    @pytest.mark.parametrize("fps", [7, 30, 240])
    def test_every_frame_stands_at_its_time(self, tmp_path, settings, fps):
        (tmp_path / "x.mp4").write_bytes(video.encode((painted(n) for n in range(9)), fps, settings))
        found = decoded(tmp_path / "x.mp4")
        assert [time for time, _ in found] == [Fraction(n, fps) for n in range(9)]
        assert [number_in(image) for _, image in found] == list(range(9))

    @BOTH
    def test_there_are_no_b_frames_and_key_frames_as_asked(self, tmp_path, settings):
        data = video.encode(scene(), 30, settings.model_copy(update={"crf": 30, "keyframes": 4}))
        (tmp_path / "x.mp4").write_bytes(data)
        with av.open(str(tmp_path / "x.mp4")) as container:
            packets = [packet for packet in container.demux(video=0) if packet.dts is not None]
            assert all(packet.pts == packet.dts for packet in packets)
            assert [n for n, packet in enumerate(packets) if packet.is_keyframe] == list(range(0, 16, 4))
            assert container.streams.video[0].codec_context.has_b_frames == 0
        with av.open(str(tmp_path / "x.mp4")) as container:
            kinds = {int(frame.pict_type) for frame in container.decode(video=0)}
        assert kinds <= {1, 2}  # I and P; 3 is B

    @BOTH
    def test_blocks_are_lit_in_the_frames_in_which_they_were_lit(self, tmp_path, settings):
        """The fastest presets of SVT-AV1 leave out what is small and changes between key frames, whatever the quality."""
        rare = settings.model_copy(update={"keyframes": 40})
        images = (busy.painted(number)[..., ::-1] for number in range(100))
        (tmp_path / "x.mp4").write_bytes(video.encode(images, 30, rare))
        assert [busy.number_in(image) for _, image in decoded(tmp_path / "x.mp4")] == list(range(100))

    @BOTH
    def test_frames_are_converted_with_the_matrix_that_is_tagged(self, tmp_path, settings):
        """Saturated colours come back: with the other matrix, levels are off by up to 40."""
        colours = [(200, 30, 30), (30, 200, 30), (30, 30, 200)]
        blue_first = [np.full((64, 64, 3), colour[::-1], np.uint8) for colour in colours]
        fine = settings.model_copy(update={"crf": 4})
        (tmp_path / "x.mp4").write_bytes(video.encode(blue_first, 30, fine))
        with av.open(str(tmp_path / "x.mp4")) as container:
            context = container.streams.video[0].codec_context
            assert (context.colorspace, context.color_primaries, context.color_trc) == (6, 6, 6)
            assert context.color_range == 1
            for frame, colour in zip(container.decode(video=0), colours, strict=True):
                y, u, v = frame.to_ndarray().reshape(-1)[[0, 64 * 64, 64 * 80]].astype(float)
                r, g, b = colour
                assert y == pytest.approx(16 + (65.481 * r + 128.553 * g + 24.966 * b) / 255, abs=2)
                assert u == pytest.approx(128 + (-37.797 * r - 74.203 * g + 112 * b) / 255, abs=2)
                assert v == pytest.approx(128 + (112 * r - 93.786 * g - 18.214 * b) / 255, abs=2)

    def test_sizes_become_even(self):
        odd = np.arange(5 * 7 * 3, dtype=np.uint8).reshape(5, 7, 3)
        assert (video.even(odd, "crop") == odd[:4, :6]).all()
        padded = video.even(odd, "pad")
        assert padded.shape == (6, 8, 3)
        assert (padded[:5, :7] == odd).all()
        assert (padded[5, :7] == odd[4]).all()
        assert (padded[:5, 7] == odd[:, 6]).all()

    def test_a_repeated_image_is_a_frame_of_its_own(self, tmp_path):
        one, other = painted(1), painted(2)
        (tmp_path / "x.mp4").write_bytes(video.encode([one, one, other, other, other], 30, H264))
        assert [number_in(image) for _, image in decoded(tmp_path / "x.mp4")] == [1, 1, 2, 2, 2]

    @BOTH
    def test_no_thread_becomes_a_real_time_one(self, settings):
        """As SVT-AV1 would have it for root; with this process, all that it starts later would be."""

        def policies():
            found = set()
            for task in Path("/proc/self/task").iterdir():
                with suppress(ProcessLookupError):  # that thread has just ended
                    found.add(os.sched_getscheduler(int(task.name)))
            return found

        def images():
            for image in scene(3):
                yield image
                meanwhile.append(policies())

        meanwhile = []
        video.encode(images(), 30, settings)
        assert meanwhile == 3 * [{os.SCHED_OTHER}]
        assert policies() == {os.SCHED_OTHER}


class TestSameBytes:
    @pytest.mark.parametrize("codec", ["h264", "av1"])
    def test_with_and_without_the_features_of_this_processor(self, codec):
        """FFmpeg's by its own flags, x264's and SVT-AV1's by their parameter `asm`."""
        found = {
            how: subprocess.run(
                [sys.executable, "-c", MASKED, how, codec], capture_output=True, text=True, check=True
            ).stdout
            for how in ("masked", "as it is")
        }
        assert found["masked"] == found["as it is"] != ""

    @BOTH
    def test_of_the_locked_encoders(self, settings):
        found = digest_bytes(video.encode(scene(), 30, settings))
        golden = GOLDEN.get(version("av"), {})
        assert golden.get(settings.codec, found) == found

    def test_whatever_the_number_of_processors(self):
        whole = digest_bytes(video.encode(scene(), 30, H264))
        there = os.sched_getaffinity(0)
        os.sched_setaffinity(0, {min(there)})
        try:
            assert digest_bytes(video.encode(scene(), 30, H264)) == whole
        finally:
            os.sched_setaffinity(0, there)


class TestJoining:
    def test_frames_follow_each_other_at_exact_times(self, tmp_path, films):
        video.join(films, 30, tmp_path / "joined.mp4")
        found = decoded(tmp_path / "joined.mp4")
        assert [time for time, _ in found] == [Fraction(n, 30) for n in range(20)]
        assert [number_in(image) for _, image in found] == [*range(7), 100, *range(200, 212)]
        with av.open(str(tmp_path / "joined.mp4")) as container:
            stream = container.streams.video[0]
            assert stream.duration * stream.time_base == Fraction(20, 30)
            assert stream.average_rate == 30

    def test_packets_are_copied(self, tmp_path, films):
        video.join(films, 30, tmp_path / "joined.mp4")

        def packets(path):
            with av.open(str(path)) as container:
                return [bytes(packet) for packet in container.demux(video=0) if packet.dts is not None]

        assert packets(tmp_path / "joined.mp4") == [one for path, _ in films for one in packets(path)]

    def test_any_frame_can_be_sought(self, tmp_path, films):
        video.join(films, 30, tmp_path / "joined.mp4")
        numbers = [*range(7), 100, *range(200, 212)]
        with av.open(str(tmp_path / "joined.mp4")) as container:
            stream = container.streams.video[0]
            for wanted in reversed(range(20)):
                container.seek(int(Fraction(wanted, 30) / stream.time_base), stream=stream)
                found = next(
                    f for f in container.decode(video=0) if f.pts * stream.time_base >= Fraction(wanted, 30)
                )
                assert number_in(found.to_ndarray(format="rgb24")) == numbers[wanted]

    def test_the_same_parts_give_the_same_bytes(self, tmp_path, films):
        video.join(films, 30, tmp_path / "a.mp4")
        video.join(films, 30, tmp_path / "b.mp4")
        assert (tmp_path / "a.mp4").read_bytes() == (tmp_path / "b.mp4").read_bytes()

    def test_av1(self, tmp_path):
        parts = []
        for part, frames in enumerate((5, 4)):
            (tmp_path / f"{part}.mp4").write_bytes(
                video.encode((painted(100 * part + n) for n in range(frames)), 30, AV1)
            )
            parts.append((tmp_path / f"{part}.mp4", frames))
        video.join(parts, 30, tmp_path / "joined.mp4")
        found = decoded(tmp_path / "joined.mp4")
        assert [time for time, _ in found] == [Fraction(n, 30) for n in range(9)]
        assert [number_in(image) for _, image in found] == [*range(5), *range(100, 104)]

    def test_a_part_that_lacks_a_frame_is_refused(self, tmp_path, films):
        (path, frames), *_ = films
        with pytest.raises(DatasetError, match="has 7 frames instead of 8"):
            video.join([(path, frames + 1)], 30, tmp_path / "joined.mp4")

    def test_settings_that_differ_show_in_the_header(self):
        kinds = [
            video.header(video.encode([painted(1, size), painted(2, size)], 30, settings))
            for size, settings in (((64, 64), H264), ((64, 96), H264), ((64, 64), AV1))
        ]
        assert all(one != other for one, other in pairwise(kinds))
