"""Video: each picture stands at the time of its own message, and none that refers to what is missing is ever shown."""

import os
import pickle
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from bagassets.base.errors import DecodeError, RecordingError
from bagassets.decode import video
from bagassets.decode.video import (
    AFTER_ERROR,
    AFTER_GAP,
    BEFORE_KEY,
    NO_PICTURE,
    REFUSED,
    VideoStream,
    decode_video_packet,
)
from bagassets.decode.video_units import UnitReader
from bagassets_tests.video_streams import PATCHES, SIZE, X264, X265, encode, number_in

START_NS, PERIOD_NS = 1_700_000_000_000_000_000, 50_000_000
ROOT = Path(__file__).parents[2]
CODECS = {"libx264": "h264", "libx265": "h265", "libsvtav1": "av1", "libvpx-vp9": "vp9"}
NAL = ["libx264", "libx265"]


def message(number, data, name="h264", **fields):
    stamp_ns = START_NS + number * PERIOD_NS
    stamp = SimpleNamespace(sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    return SimpleNamespace(
        timestamp=stamp, frame_id="/cam", data=np.frombuffer(data, np.uint8), format=name, **fields
    )


def packets(stream, codec="libx264"):
    return [decode_video_packet(message(number, data, CODECS[codec])) for number, data in stream]


def shown(some, *, period_ns=PERIOD_NS, most_pixels=10**6):
    """Return what becomes of packets: number in time -> number painted in the picture, or why it is lost."""
    stream = VideoStream("CAM (/cam)", most_pixels, period_ns)
    pictures = [picture for at, packet in enumerate(some) for picture in stream.add(packet, at)]
    pictures += stream.finish()
    assert len(pictures) == len(some)  # counts in = counts out
    return {
        (picture.packet.stamp_ns - START_NS) // PERIOD_NS: picture.reason if picture.pixels is None else number_in(picture.pixels)
        for picture in pictures
    }  # fmt: skip


@pytest.mark.parametrize("codec", CODECS)
def test_each_picture_stands_at_the_time_of_its_own_message(codec):
    assert shown(packets(encode(codec), codec)) == {number: number for number in range(40)}


def test_an_encoder_that_cuts_pictures_into_slices():
    stream = encode(options={**X264, "slices": "4"})
    assert shown(packets(stream)) == {number: number for number in range(40)}


@pytest.mark.parametrize("codec", CODECS)
def test_a_stream_cut_at_the_front_begins_at_its_first_key_frame(codec):
    found = shown(packets(encode(codec), codec)[3:])
    assert found == {number: number if number >= 10 else BEFORE_KEY for number in range(3, 40)}


@pytest.mark.parametrize("codec", CODECS)
def test_packets_lost_in_the_middle_cost_the_pictures_up_to_the_next_key_frame(codec):
    kept = [packet for at, packet in enumerate(packets(encode(codec), codec)) if at != 14]
    found = shown(kept)
    assert found == {n: AFTER_GAP if 15 <= n < 20 else n for n in range(40) if n != 14}
    # A key frame after a gap needs nothing before it.
    kept = [packet for at, packet in enumerate(packets(encode(codec), codec)) if at not in range(17, 20)]
    assert shown(kept) == {n: n for n in range(40) if n not in range(17, 20)}


def test_a_lost_key_frame_costs_all_that_refers_to_it():
    kept = [packet for at, packet in enumerate(packets(encode())) if at != 20]
    assert shown(kept) == {n: AFTER_GAP if 20 < n < 30 else n for n in range(40) if n != 20}


def test_stamps_that_jitter_are_no_gap_and_without_a_period_none_is_looked_for():
    stream = packets(encode())
    late = [replace(one, stamp_ns=one.stamp_ns + (at % 3) * 8_000_000) for at, one in enumerate(stream)]
    assert set(shown(late).values()) == set(range(40))
    assert set(shown(stream[:5] + stream[10:], period_ns=None).values()) == {*range(5), *range(10, 40)}


@pytest.mark.parametrize("codec", [*NAL, "libsvtav1"])
def test_what_is_missing_is_noticed_without_stamps_too(codec):
    """The decoder of H.264 would show picture 13 for number 15, without an error: its frame numbers tell."""
    kept = [packet for at, packet in enumerate(packets(encode(codec), codec)) if at != 14]
    found = shown(kept, period_ns=None)
    assert {found[n] for n in range(15, 20)} <= {AFTER_GAP, AFTER_ERROR, REFUSED}
    assert all(found[n] == n for n in range(40) if not 14 <= n < 20)


def test_pictures_that_the_decoder_holds_back_are_not_lost():
    """A stream that says that it may have B-frames, and has none: each picture comes two packets late."""
    options = {"preset": "medium", "x264-params": "bframes=2:b-bias=-100"}
    some = packets(encode(b_frames=2, options=options))
    assert shown(some) == {n: n for n in range(40)}
    assert shown([one for at, one in enumerate(some) if at != 14]) == {
        n: AFTER_GAP if 15 <= n < 20 else n for n in range(40) if n != 14
    }


@pytest.mark.parametrize(
    ("codec", "options"),
    [
        ("libsvtav1", {"preset": "8", "crf": "20"}),
        ("libvpx-vp9", {"cpu-used": "8", "lag-in-frames": "10", "auto-alt-ref": "1", "arnr-strength": "0"}),
    ],
)
def test_frames_that_are_hidden_for_later_pictures_change_nothing(codec, options):
    """Encoders with delay: a packet of AV1 or VP9 has the frames that are hidden until later, and one that is shown."""
    stream = encode(codec, options=options)
    assert [number for number, _ in stream] == list(range(40))
    assert shown(packets(stream, codec)) == {number: number for number in range(40)}


@pytest.mark.parametrize(
    ("codec", "data", "expected"),
    [
        ("av1", "1200 0a01ff", (False, False)),  # a delimiter, parameters
        ("av1", "1200 0a01ff 320110", (True, True)),
        ("av1", "3601 0110", (True, True)),  # with an extension
        ("av1", "3010", (True, True)),  # without a size, so up to the end
        ("av1", "3281 0010", (True, True)),  # a size in more bytes than are needed
        ("av1", "32810110" + 128 * "00", (True, True)),
        ("av1", "320100", (True, False)),  # a key frame that is hidden
        ("av1", "320130", (True, False)),
        ("av1", "1a0190", (True, False)),  # shown before
        ("vp9", "82", (True, True)),
        ("vp9", "86", (True, False)),
        ("vp9", "88", (True, False)),  # shown before
        ("vp9", "b1", (True, True)),  # profile 3
        ("vp9", "b3", (True, False)),
    ],
)
def test_what_frames_say_before_they_are_decoded(codec, data, expected):
    units = UnitReader().read(codec, bytes.fromhex(data))
    assert (units.has_picture, units.is_key) == expected


@pytest.mark.parametrize(
    ("codec", "data", "message"),
    [
        ("av1", "b20110", "low-overhead format"),
        ("av1", "320210", "cut off"),
        ("av1", "32", "cut off"),
        ("av1", "32" + 9 * "81" + "01" + 200 * "10", "low-overhead format"),
        ("av1", "3200 0a0110", "cut off"),
        ("vp9", "", "not a frame of VP9"),
        ("vp9", "0000000165", "not a frame of VP9"),
    ],
)
def test_what_is_no_frame_is_refused(codec, data, message):
    with pytest.raises(DecodeError, match=message):
        UnitReader().read(codec, bytes.fromhex(data))


def slower(packet, by, since=12):
    """Return a packet of a camera that makes a picture every `by` periods from a number on."""
    number = (packet.stamp_ns - START_NS) // PERIOD_NS
    return replace(packet, stamp_ns=START_NS + PERIOD_NS * (number + (by - 1) * max(0, number - since)))


def test_a_camera_that_slows_down_loses_nothing_where_pictures_are_numbered():
    stream = packets(encode())
    assert list(shown([slower(one, 3) for one in stream]).values()) == list(range(40))
    # So slow that the numbers, of which x264 has 16 at least, may have begun again meanwhile.
    assert AFTER_GAP in shown([slower(one, 100) for one in stream]).values()
    # In H.265 they are not.
    found = list(shown([slower(one, 3) for one in packets(encode("libx265"), "libx265")]).values())
    assert found == [n if n <= 12 or n % 10 == 0 else AFTER_GAP for n in range(40)]


def test_frame_numbers_begin_again_in_long_groups():
    stream = packets(encode(number=90, gop=80))
    assert shown(stream) == {n: n for n in range(90)}
    assert shown(stream[:40] + stream[41:], period_ns=None) == {
        n: n if n < 40 or n >= 80 else AFTER_GAP for n in range(90) if n != 40
    }


@pytest.mark.parametrize(("log2", "numbers"), [(0, 16), (12, 1 << 16), (13, 0), (2000, 0)])
def test_more_frame_numbers_than_the_standard_has_are_none(log2, numbers):
    """A few bytes may announce a number that no memory holds."""
    code = f"{log2 + 1:b}"
    # Profile, constraints and level; number of the set; frame numbers; order as decoded, one reference, no gaps.
    bits = f"{0x42001E:024b}" + "1" + "0" * (len(code) - 1) + code + "011" + "010" + "0"
    bits += "0" * (-len(bits) % 8)
    parameters = int(bits, 2).to_bytes(len(bits) // 8, "big")
    reader = UnitReader()
    reader.read("h264", b"\0\0\0\1\x67" + parameters + bytes(8))
    assert reader.frame_numbers == numbers


@pytest.mark.parametrize("codec", CODECS)
def test_a_damaged_packet_costs_itself_and_what_follows(codec):
    stream = encode(codec)
    number, data = stream[12]
    # That of H.265 takes any half of a packet for a whole one.
    stream[12] = (
        number,
        data[: len(data) // 2] if codec == "libx264" else data[:5] + b"\xff" * (len(data) - 5),
    )
    found = shown(packets(stream, codec))
    assert found[12] == REFUSED
    assert {found[n] for n in range(13, 20)} <= {AFTER_ERROR, REFUSED}
    assert all(found[n] == n for n in range(40) if not 12 <= n < 20)


@pytest.mark.parametrize(
    ("codec", "options"),
    [("libx264", X264), ("libx264", {**X264, "x264-params": "cabac=1"}), ("libx265", X265)],
)
def test_zeros_in_the_middle_of_a_packet_are_seen_where_decoders_make_something_up(codec, options):
    """A picture of noise, so that the hole never begins in padding; the decoders alone show most of these wrong."""
    stream = encode(codec, 20, noise=True, options=options)
    for hole in (4, 16, 300):
        damaged = list(stream)
        data = bytearray(stream[13][1])
        middle = len(data) // 2
        data[middle : middle + hole] = bytes(hole)
        damaged[13] = (13, bytes(data))
        after = reasons(damaged, codec)
        assert after[13].startswith("zeros are in the middle of its data"), (codec, hole)
        assert set(map(after.get, range(14, 20))) == {AFTER_GAP}
        assert not any(map(after.get, range(13)))


def test_zeros_that_end_a_unit_are_none_of_its_data():
    stream = [(number, data.replace(b"\0\0\0\1", b"\0\0\0\0\0\1") + bytes(40)) for number, data in encode()]
    assert shown(packets(stream)) == {number: number for number in range(40)}


def test_a_picture_that_its_encoder_digested_is_compared():
    """Nothing else gives away a flipped bit in H.265."""
    codec = "libx265"
    stream = encode(codec, options={**X265, "x265-params": X265["x265-params"] + ":hash=1"})
    assert shown(packets(stream, codec)) == {number: number for number in range(40)}
    data = bytearray(stream[13][1])
    data[-4] ^= 16
    stream[13] = (13, bytes(data))
    after = reasons(stream, codec)
    assert after[13] == REFUSED
    assert set(map(after.get, range(14, 20))) == {AFTER_ERROR}
    assert not any(after[number] for number in (*range(13), *range(20, 40)))


def reasons(stream, codec):
    """Return number in time -> why it is lost, "" if it is not."""
    decoder = VideoStream("CAM (/cam)", 10**6, PERIOD_NS)
    found = [one for at, packet in enumerate(packets(stream, codec)) for one in decoder.add(packet, at)]
    found += decoder.finish()
    return {(one.packet.stamp_ns - START_NS) // PERIOD_NS: one.reason for one in found}


def test_parameters_that_were_sent_once_or_by_themselves_hold_on():
    key, *_ = stream = encode(gop=10)
    parameters = b"".join(unit for unit in split(key[1]) if unit[3] & 31 in {7, 8})
    bare = [(n, b"".join(u for u in split(data) if u[3] & 31 not in {7, 8})) for n, data in stream]
    # Sent once, in a message of their own; the stream has a gap later on.
    some = packets([(-1, parameters), *bare[:14], *bare[15:]])
    found = shown(some)
    assert found.pop(-1) == NO_PICTURE
    assert found == {n: AFTER_GAP if 15 <= n < 20 else n for n in range(40) if n != 14}


def split(data):
    return [b"\0\0\1" + unit for unit in data.replace(b"\0\0\0\1", b"\0\0\1").split(b"\0\0\1") if unit]


@pytest.mark.parametrize("order", ["as in the file", "by time"])
@pytest.mark.parametrize("codec", NAL)
def test_b_frames_are_refused_in_any_order(codec, order):
    options = {"preset": "ultrafast"} | (
        {"x265-params": "log-level=none:bframes=2:b-adapt=0"} if codec == "libx265" else {}
    )
    stream = encode(codec, b_frames=2, options=options)
    assert [number for number, _ in stream] != list(range(40))
    some = packets(stream if order == "as in the file" else sorted(stream), codec)
    with pytest.raises(RecordingError, match=r"CAM \(/cam\): its video has B-frames"):
        shown(some)


@pytest.mark.parametrize("pixels", ["yuv420p", "yuv420p10le"])
@pytest.mark.parametrize(
    ("matrix", "full"), [(None, False), ("ITU601", False), ("ITU709", False), ("ITU709", True)]
)
def test_colours_are_those_of_the_matrix_and_range_that_are_tagged(matrix, full, pixels):
    codec, options = ("libx264", X264) if pixels == "yuv420p" else ("libx265", X265)
    stream = encode(codec, 1, matrix=matrix, full=full, options={**options, "qp": "4"}, pixels=pixels)
    video = VideoStream("", 10**6, None)
    pictures = [one for packet in packets(stream, codec) for one in video.add(packet, 0)]
    (picture,) = [*pictures, *video.finish()]
    for at, colour in enumerate(PATCHES):
        mean = picture.pixels[24:56, 20 + 44 * at : 32 + 44 * at].reshape(-1, 3).mean(axis=0)
        assert np.abs(mean[::-1] - colour).max() < 3.5


def test_pictures_beyond_the_limit_are_not_decoded():
    found = shown(packets(encode(number=3)), most_pixels=SIZE[0] * SIZE[1] - 1)
    assert set(found.values()) <= {REFUSED, AFTER_ERROR}
    assert found[0] == REFUSED


@pytest.mark.parametrize(
    ("name", "codec"),
    [
        ("h264", "h264"),
        ("h265", "hevc"),
        ("libx264", "h264"),
        ("h264_nvenc", "h264"),
        ("hevc_vaapi", "hevc"),
        ("hevc;nv12;bgr8", "hevc"),
        ("av1", "av1"),
        ("libsvtav1", "av1"),
        ("av1_nvenc;nv12;bgr8", "av1"),
        ("vp9", "vp9"),
        ("libvpx-vp9", "vp9"),
    ],
)
def test_names_of_codecs(name, codec):
    assert decode_video_packet(message(0, b"\0\0\0\1\x65\x88", name)).codec == codec


@pytest.mark.parametrize("name", ["vp8", "", "mjpeg"])
def test_other_codecs_are_named(name):
    with pytest.raises(DecodeError, match=f"video format '{name}' is not supported"):
        decode_video_packet(message(0, b"\0\0\0\1\x65\x88", name))


def test_video_with_lengths_in_place_of_start_codes_is_refused():
    (reason,) = shown([decode_video_packet(message(0, b"\0\0\0\x08\x65\x88\x80\0\0\0\0\0"))]).values()
    assert "Annex B" in reason


def test_without_pyav_the_command_that_installs_it_is_said(monkeypatch):
    def nothing(_name):
        raise video.PackageNotFoundError

    monkeypatch.setattr(video, "version", nothing)
    with pytest.raises(DecodeError, match=r"^CAM \(/cam\): .*`pip install 'bagassets\[video\]'`"):
        video.decoder_version("CAM (/cam)")


MASKED = """
import ctypes, hashlib, pickle, sys
import av
from bagassets.decode.video import VideoStream
path, mask = sys.argv[1:]
if mask != "none":
    # The library that PyAV has loaded already.
    (library,) = {line.split()[-1] for line in open("/proc/self/maps") if "libavutil" in line}
    library = ctypes.CDLL(library)
    before = library.av_get_cpu_flags()
    library.av_force_cpu_flags(int(mask))
    assert library.av_get_cpu_flags() != before
for stream in pickle.load(open(path, "rb")):
    video, digest = VideoStream("", 10**6, None), hashlib.sha256()
    for picture in [*(one for packet in stream for one in video.add(packet, 0)), *video.finish()]:
        digest.update(picture.pixels.tobytes())
    print(digest.hexdigest())
"""


@pytest.mark.skipif(sys.platform != "linux", reason="finds the library in /proc")
def test_pictures_are_the_same_bytes_whatever_the_processor_can_do(tmp_path):
    """Of noise, and of a width that is no multiple of what vectors hold."""
    script, streams = tmp_path / "masked.py", tmp_path / "streams"
    script.write_text(MASKED)
    noise = {"number": 8, "noise": True, "size": (198, 114)}
    some = [
        packets(encode(codec, matrix=matrix, **noise), codec)
        for codec in CODECS
        for matrix in (None, "ITU709")
    ]
    streams.write_bytes(pickle.dumps(some))
    digests = [
        subprocess.run(
            [sys.executable, script, streams, mask], capture_output=True, text=True, check=True,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
        ).stdout.split()
        for mask in ("none", "0")
    ]  # fmt: skip
    assert len(digests[0]) == len(some)
    assert digests[0] == digests[1]
