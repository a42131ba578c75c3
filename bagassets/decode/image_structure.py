"""Checking that a JPEG or PNG is whole, every segment and chunk up to its end.

Decoders return a picture for damaged bytes without an error, and files that are passed through are not decoded at all.
Sources: ITU-T T.81, annex B; the PNG specification, sections 5 and 11.

Texts of errors contain no numbers, because steps count lost messages by them.
"""

import re
import struct
import zlib
from collections.abc import Iterator

import numpy as np

from bagassets.base.errors import DecodeError

JPEG, PNG = b"\xff\xd8\xff", b"\x89PNG\r\n\x1a\n"

_START = b"\xff\xd8"
_PADDING = re.compile(rb"\x00*")
_END, _SCAN, _TABLES, _QUANTISATION, _INTERVAL = 0xD9, 0xDA, 0xC4, 0xDB, 0xDD
_RESTARTS = range(0xD0, 0xD8)
# SOF0-SOF15 but DHT, JPG and DAC in between.
_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
# Other segments with a length: DHT, DAC, DNL, DHP, EXP, JPGn, APPn, COM.
_SEGMENTS = _FRAMES | {0xC4, 0xCC, *range(0xDA, 0xE0), *range(0xE0, 0xFF)}

# A progressive JPEG has about ten scans, each with its tables; profiles and comments are split into 64 kB.
_MOST_SEGMENTS = 5000
# Bytes that are searched for markers at once, at first and at the most: there may be many short scans.
_WINDOW, _MOST = 1 << 12, 1 << 18

_FRAME_SIZE = struct.Struct(">HH")
_CHUNK = struct.Struct(">I4s")
_HEADER = struct.Struct(">II")
_CHUNK_TYPE = re.compile(rb"[A-Za-z]{4}")


def check_jpeg(data: memoryview) -> tuple[int, int]:
    """Check that the segments and scans of a JPEG are whole up to its end; return width and height.

    Zeros may follow, because drivers pad with them, and further pictures, as in stereo and preview files.

    Raises:
        DecodeError: it is cut off, or a segment is out of place.
    """
    size, at = _picture(data, 0)
    while (at := _after_padding(data, at)) < len(data):
        if data[at : at + 2] != _START:
            raise DecodeError("the JPEG goes on after its end")
        _, at = _picture(data, at)
    return size


def _picture(data: memoryview, at: int) -> tuple[tuple[int, int], int]:
    """Return the size of the picture that begins at `at`, and where it ends."""
    size: tuple[int, int] | None = None
    interval = 0
    has_scan = False
    at += len(_START)
    for _ in range(_MOST_SEGMENTS):
        if at + 2 > len(data):
            raise DecodeError("the JPEG is cut off")
        marker = data[at + 1]
        if data[at] != 0xFF or not (marker in _SEGMENTS or marker == 0xFF):
            if has_scan and marker == _END and data[at] == 0xFF and size is not None:
                return size, at + 2
            raise DecodeError("the JPEG is damaged: a segment does not begin where the one before it ends")
        if marker == 0xFF:  # fill bytes may stand before a marker
            at += 1
            continue
        if at + 4 > len(data) or (end := at + 2 + (data[at + 2] << 8 | data[at + 3])) > len(data):
            raise DecodeError("the JPEG is cut off")
        inside = data[at + 4 : end]
        if not _fits(marker, inside):
            raise DecodeError("the JPEG is damaged: the length of a segment contradicts what is in it")
        if marker in _FRAMES:
            if size is not None:
                raise DecodeError("the JPEG is damaged: its frame begins twice")
            height, width = _FRAME_SIZE.unpack_from(inside, 1)
            size = width, height
        elif marker == _INTERVAL:
            interval = inside[0] << 8 | inside[1]
        elif marker == _SCAN:
            if size is None:
                raise DecodeError("the JPEG is damaged: a scan begins before the frame")
            has_scan = True
            end = _end_of_scan(data, end, restarts=interval > 0)
        at = end
    raise DecodeError("the JPEG has more segments than any picture needs")


def _fits(marker: int, inside: memoryview) -> bool:
    """Tell whether the length of a segment fits its content."""
    if marker in _FRAMES:
        return len(inside) >= 9 and len(inside) == 6 + 3 * inside[5] and any(inside[1:3]) and any(inside[3:5])
    if marker == _SCAN:
        return len(inside) >= 6 and len(inside) == 4 + 2 * inside[0]
    if marker == _INTERVAL:
        return len(inside) == 2
    at = 0
    if marker == _QUANTISATION:
        while at < len(inside):
            at += 65 if inside[at] < 16 else 129
    elif marker == _TABLES:
        while at < len(inside):
            at += 17 + sum(inside[at + 1 : at + 17])
    else:
        return True
    return at == len(inside) > 0


def _end_of_scan(data: memoryview, at: int, *, restarts: bool) -> int:
    """Return where the marker stands that ends a scan; those that restart it stand in order."""
    expected = 0
    for marker_at in _markers(data, at):
        marker = data[marker_at + 1]
        if marker not in _RESTARTS:
            return marker_at
        if not restarts or marker & 7 != expected:
            raise DecodeError("the JPEG is damaged: a part of its scan is missing or strange")
        expected = (expected + 1) & 7
    raise DecodeError("the JPEG is cut off")


def _markers(data: memoryview, at: int) -> Iterator[int]:
    """Yield where markers stand from `at` on: 0xff before anything but the zero that follows it in the data of a scan.

    Of 0xff repeated, which may stand before a marker, the last one counts.
    """
    size = _WINDOW
    while at < len(data) - 1:
        window = np.frombuffer(data[at : at + size + 1], np.uint8)  # with what follows its last byte
        places = np.flatnonzero(window[:-1] == 0xFF)
        following = window[places + 1]
        yield from (at + places[(following != 0) & (following != 0xFF)]).tolist()
        at, size = at + size, min(4 * size, _MOST)


def _after_padding(data: memoryview, at: int) -> int:
    found = _PADDING.match(data, at)
    return at if found is None else found.end()


def check_png(data: memoryview) -> tuple[int, int]:
    """Return width and height of a PNG whose chunks are whole, by their checksums, up to its end.

    Zeros may follow, which drivers pad with.

    Raises:
        DecodeError: it is cut off, a checksum is wrong, or there is something that cannot be where it is.
    """
    at = len(PNG)
    kind = b""
    has_data = False
    while kind != b"IEND":
        if at + 12 > len(data):
            raise DecodeError("the PNG is cut off")
        length, kind = _CHUNK.unpack_from(data, at)
        if not _CHUNK_TYPE.fullmatch(kind) or (at == len(PNG)) != (kind == b"IHDR"):
            raise DecodeError("the PNG is damaged: a chunk does not begin where the one before it ends")
        end = at + 8 + length
        if end + 4 > len(data):
            raise DecodeError("the PNG is cut off")
        if zlib.crc32(data[at + 4 : end]) != int.from_bytes(data[end : end + 4]):
            raise DecodeError("the PNG is damaged: the checksum of a chunk is wrong")
        has_data = has_data or kind == b"IDAT"
        at = end + 4
    if not has_data:
        raise DecodeError("the PNG has no pixels")
    if _after_padding(data, at) < len(data):
        raise DecodeError("the PNG goes on after its end")
    width, height = _HEADER.unpack_from(data, len(PNG) + 8)
    return width, height
