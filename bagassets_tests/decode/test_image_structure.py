"""JPEG and PNG: whole ones of every make are taken, and each kind of damage is a lost message."""

import random
import re
import struct
import zlib
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from bagassets.assets.frames import FrameExtractor
from bagassets.base.errors import DecodeError
from bagassets.decode import image_structure
from bagassets.decode.compressed_image import checked_size
from bagassets.store.artifact import ArtifactWriter
from bagassets_tests.cameras import camera_use
from bagassets_tests.decoded_images import pixels_of

pytestmark = pytest.mark.once

HEIGHT, WIDTH = 120, 200
NOISE = np.random.default_rng(5).integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)


def encoded(extension, *options, image=NOISE):
    return cv2.imencode(extension, image, options)[1].tobytes()


PLAIN = encoded(".jpg", cv2.IMWRITE_JPEG_QUALITY, 80)
GREY = encoded(".jpg", image=NOISE[:, :, 0].copy())
PROGRESSIVE = encoded(".jpg", cv2.IMWRITE_JPEG_PROGRESSIVE, 1)
RESTARTS = encoded(".jpg", cv2.IMWRITE_JPEG_RST_INTERVAL, 5)
PNG = encoded(".png")
DEEP = encoded(".png", image=NOISE[:, :, 0].astype(np.uint16) * 257)

SCAN = PLAIN.index(b"\xff\xda")
FRAME = PLAIN.index(b"\xff\xc0")
TABLES = PLAIN.index(b"\xff\xc4")
QUANTISATION = PLAIN.index(b"\xff\xdb")


def with_segment(data, marker, content):
    return data[:2] + bytes([0xFF, marker]) + struct.pack(">H", 2 + len(content)) + content + data[2:]


WHOLE = {
    "plain": PLAIN,
    "grey": GREY,
    "progressive": PROGRESSIVE,
    "restarts": RESTARTS,
    "padded": PLAIN + bytes(20_000),
    "a preview inside its EXIF segment": with_segment(PLAIN, 0xE1, b"Exif\0\0" + GREY),
    "a comment": with_segment(PLAIN, 0xFE, b"\xff\xd9 no end"),
    "fill bytes before markers": PLAIN[:SCAN] + b"\xff\xff" + PLAIN[SCAN:-2] + b"\xff" + PLAIN[-2:],
    "two pictures": PLAIN + bytes(6) + GREY,
    "png": PNG,
    "16 bit png": DEEP,
    "padded png": PNG + bytes(7),
}


@pytest.mark.parametrize("name", WHOLE)
def test_whole_ones_are_taken(name):
    data = WHOLE[name]
    kind = "png" if "png" in name else "jpeg"
    assert checked_size(data, kind) == (WIDTH, HEIGHT)
    assert pixels_of(data, kind).shape[:2] == (HEIGHT, WIDTH)


def changed(data, at, new):
    return data[:at] + new + data[at + len(new) :]


def chunks(data):
    at = 8
    while at < len(data):
        length = int.from_bytes(data[at : at + 4])
        yield data[at + 4 : at + 8], data[at : at + 12 + length]
        at += 12 + length


def png_without(kind):
    return PNG[:8] + b"".join(chunk for name, chunk in chunks(PNG) if name != kind)


def chunk(kind, content):
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


RESTART_2 = RESTARTS.index(b"\xff\xd2")
DAMAGED = {
    "cut off in its scan": (PLAIN[:-300], "the JPEG is cut off"),
    "cut off in its scan, then padded": (PLAIN[:-300] + bytes(300), "the JPEG is cut off"),
    "cut off before its scan": (PLAIN[:SCAN], "the JPEG is cut off"),
    "cut off in a segment": (PLAIN[: TABLES + 20], "the JPEG is cut off"),
    "cut off in a marker": (PLAIN[: TABLES + 1], "the JPEG is cut off"),
    "no scan": (PLAIN[:SCAN] + b"\xff\xd9", "a segment does not begin"),
    "a missing end, the next one follows": (PLAIN[:-300] + PLAIN, "a segment does not begin"),
    "its middle missing up to the end": (PLAIN + GREY[:-2], "the JPEG is cut off"),
    "text after its end": (PLAIN + b"HTTP/1.1 200 OK", "goes on after its end"),
    "a marker that is none": (changed(PLAIN, TABLES + 1, b"\x44"), "a segment does not begin"),
    "a longer segment": (changed(PLAIN, TABLES + 2, b"\x01\x33"), "the length of a segment contradicts"),
    "a table with other counts": (changed(PLAIN, TABLES + 8, b"\x77"), "the length of a segment contradicts"),
    "quantisation of 16 bit": (changed(PLAIN, QUANTISATION + 4, b"\x10"), "contradicts"),
    "more components": (changed(PLAIN, FRAME + 9, b"\x04"), "the length of a segment contradicts"),
    "no height": (changed(PLAIN, FRAME + 5, b"\0\0"), "the length of a segment contradicts"),
    "two frames": (PLAIN[:FRAME] + PLAIN[FRAME:TABLES] + PLAIN[FRAME:], "its frame begins twice"),
    "no frame": (PLAIN[:FRAME] + PLAIN[TABLES:], "a scan begins before the frame"),
    "a marker in the scan": (changed(PLAIN, SCAN + 900, b"\xff\xc4\x00\x10"), "contradicts"),
    "a restart where none is due": (changed(PLAIN, SCAN + 900, b"\xff\xd0"), "a part of its scan is missing"),
    "a restart missing": (changed(RESTARTS, RESTART_2, b"\x11"), "a part of its scan is missing"),
    "cut off png": (PNG[:-40], "the PNG is cut off"),
    "png without its last chunk": (png_without(b"IEND"), "the PNG is cut off"),
    "png without pixels": (png_without(b"IDAT"), "the PNG has no pixels"),
    "png without its first chunk": (png_without(b"IHDR"), "a chunk does not begin"),
    "a bit of a png": (changed(PNG, 5000, bytes([PNG[5000] ^ 4])), "the checksum of a chunk is wrong"),
    "a checksum of a png": (changed(PNG, 31, bytes([PNG[31] ^ 1])), "the checksum of a chunk is wrong"),
    "a length of a png": (changed(PNG, 33, b"\0\0\x10\0"), "the checksum of a chunk is wrong"),
    "a chunk of no type": (PNG[:33] + chunk(b"\0\1\2\3", b"") + PNG[33:], "a chunk does not begin"),
    "text after a png": (PNG + b"more", "goes on after its end"),
}


@pytest.mark.parametrize("name", DAMAGED)
def test_damage_is_refused(name):
    data, reason = DAMAGED[name]
    kind = "png" if data.startswith(b"\x89PNG") else "jpeg"
    with pytest.raises(DecodeError, match=reason):
        checked_size(data, kind)
    with pytest.raises(DecodeError, match=reason):
        pixels_of(data, kind)


@pytest.mark.parametrize(
    "data", [PLAIN, PROGRESSIVE, RESTARTS, PNG], ids=["jpeg", "progressive", "rst", "png"]
)
def test_an_image_cut_off_anywhere_is_refused(data):
    kind = "png" if data.startswith(b"\x89PNG") else "jpeg"
    for end in [*range(8, 900), *range(900, len(data), 101), len(data) - 1]:
        with pytest.raises(DecodeError):
            checked_size(data[:end], kind)


PLAIN_MARKER = re.compile(rb"\xff[^\x00\xff]")


def test_markers_are_found_wherever_they_stand():
    """Around each border, of windows and of the data; alone, repeated, and in great numbers."""
    rng = random.Random(1)
    first, window = image_structure._WINDOW, image_structure._MOST
    cases = [bytes(size) for size in (0, 1, 2)]
    for size in (1, 2, 31, 32, 33, 34, 64, 65, 300, 5000):
        cases += [bytes(rng.choices((0, 255, 0xD9, 7), (1, 2, 1, 9), k=size)) for _ in range(40)]
    ends = (first, 5 * first, 21 * first, 21 * first + window)
    for place in (0, 30, *(end + beside for end in ends for beside in range(-3, 3)), 2 * window + 31):
        data = bytearray(b"\x07" * (2 * window + 34))
        data[place : place + 2] = b"\xff\xd9"
        cases.append(bytes(data))
    cases += [
        b"\xff\xd0\x01" * 9000,
        b"\xff" * 9000,
        b"\xff" * 9000 + b"\xd9",
        b"\xff\x00" * (window + 9) + b"\xff\xd9",
    ]
    for data in cases:
        for at in (0, 3):
            found = [at + match.start() for match in PLAIN_MARKER.finditer(data[at:])]
            assert list(image_structure._markers(memoryview(data), at)) == found


def test_scans_without_end_are_refused_after_some_thousand(monkeypatch):
    """A file whose walk would take minutes: as many tiny scans as fit, each before all of the others."""
    scan = PLAIN[SCAN : SCAN + 14]
    data = memoryview(PLAIN[:SCAN] + scan * 400_000 + b"\xff\xd9")
    searches, search = [], image_structure._markers

    def markers(data, at):
        searches.append(at)
        return search(data, at)

    monkeypatch.setattr(image_structure, "_markers", markers)
    with pytest.raises(DecodeError, match="more segments than any picture needs"):
        checked_size(data, "jpeg")
    assert len(searches) <= 5000


class Decoded:
    """Hands out messages as they are."""

    def decode(self, message):
        return message.data


@pytest.mark.parametrize("output", ["as_recorded", "jpeg", "png"])
def test_each_damaged_image_is_a_lost_message_with_its_reason(tmp_path, output):
    use = camera_use("sensor_msgs/msg/CompressedImage", output=output, lost_messages=1.0)
    extractor = FrameExtractor(use, Decoded(), ArtifactWriter(tmp_path / "made"))
    images = [PLAIN, *(data for data, _ in DAMAGED.values()), PNG]
    for number, data in enumerate(images):
        header = SimpleNamespace(stamp=SimpleNamespace(sec=1, nanosec=number * 1000), frame_id="cam")
        message = SimpleNamespace(header=header, format="jpeg", data=np.frombuffer(data, np.uint8))
        extractor.add(SimpleNamespace(data=message, log_time_ns=number))
    counts = extractor.finish()["counts"]
    assert (counts["read"], counts["written"]) == (len(images), 2)
    assert sum(counts["lost"].values()) == len(DAMAGED)
    assert counts["lost"]["the JPEG is cut off"] == sum(
        r == "the JPEG is cut off" for _, r in DAMAGED.values()
    )
