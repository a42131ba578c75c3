"""What the packets of video say before they are decoded.

Of H.264 and H.265 the NAL units (ITU-T H.264, 7.3; H.265, 7.3; byte streams: Annex B), of AV1 the OBUs (AV1 Bitstream and
Decoding Process Specification, 5.3 and 5.9.2, in the low-overhead format of 5.2), of VP9 the header of the first frame (VP9
Bitstream and Decoding Process Specification, 6.2 and 7.2).
"""

import re
from typing import Literal, NamedTuple

from bagassets.base.errors import DecodeError

Codec = Literal["h264", "hevc", "av1", "vp9"]

_SLICES = {"h264": frozenset(range(1, 6)), "hevc": frozenset(range(32))}
_KEY = {"h264": frozenset({5}), "hevc": frozenset(range(16, 22))}  # IDR; IRAP
_START_CODE = re.compile(rb"\x00\x00\x01", re.DOTALL)
# Encoders break up three zeros inside a unit (H.264, 7.4.1); behind one may be any number.
_ZEROS = re.compile(rb"\0\0\0+[\2-\xff]", re.DOTALL)
_B_SLICES = {"h264": frozenset({1, 6}), "hevc": frozenset({0})}
_SPS = 7  # of H.264
_MOST_LOG2 = 16  # of the frame numbers of H.264 (7.4.2.1.1)
_HEAD_BYTES = 24  # more than the numbers take that are read of a slice
# Profiles of H.264 whose parameters begin with the format of the samples.
_HIGH = frozenset({44, 83, 86, 100, 110, 118, 122, 128, 134, 135, 138, 139, 244})
# OBUs with the header of a frame: alone, or with the frame.
_FRAMES = frozenset({3, 6})
_NOT_AV1 = "its video is not in the low-overhead format of AV1, or cut off"


class Units(NamedTuple):
    """The units of one picture.

    Attributes:
        has_picture: there is one, and not parameters alone.
        is_key: it can be decoded without those before it.
        has_b_slices: it has slices that may refer to later pictures; in AV1 and VP9, each packet has the picture that is next.
        frame_number: that of H.264, which tells whether a picture is missing before it; None if it is not known.
        is_reference: others refer to it; known of H.264 only.
    """

    has_picture: bool
    is_key: bool
    has_b_slices: bool = False
    frame_number: int | None = None
    is_reference: bool = False


class UnitReader:
    """Reads the units of a stream; of H.264, it keeps what the parameters say of frame numbers.

    Attributes:
        frame_numbers: how many there are before they begin again; 0 if they are not known, or may have gaps.
    """

    def __init__(self) -> None:
        self.frame_numbers = 0

    def read(self, codec: Codec, data: bytes) -> Units:
        """Return what is said of a picture.

        Raises:
            DecodeError: the data are not in the format of the codec's streams, are cut off, or have a hole of zeros.
        """
        if codec == "av1":
            return _of_av1(data)
        if codec == "vp9":
            return _of_vp9(data)
        starts = [found.end() for found in _START_CODE.finditer(data) if found.end() < len(data)]
        if not starts or data[: starts[0] - 3].strip(b"\0"):
            raise DecodeError("its video is not in the byte stream format (Annex B)")
        types = tuple(data[at] & 31 if codec == "h264" else data[at] >> 1 & 63 for at in starts)
        has_b_slices, number, is_reference = False, None, False
        for at, end, unit in zip(starts, [*starts[1:], len(data)], types, strict=True):
            if codec == "h264" and unit == _SPS:
                self.frame_numbers = _frame_numbers(data[at + 1 : at + 1 + 4 * _HEAD_BYTES])
            if unit in _SLICES[codec]:
                if _ZEROS.search(data, at, end):
                    raise DecodeError("zeros are in the middle of its data, which no encoder writes")
                slice_type, number_now = self._slice(codec, unit, data[at : at + _HEAD_BYTES])
                has_b_slices |= slice_type in _B_SLICES[codec]
                number = number_now if number is None else number
                is_reference |= bool(data[at] >> 5 & 3)
        has_picture, is_key = (not of[codec].isdisjoint(types) for of in (_SLICES, _KEY))
        return Units(has_picture, is_key, has_b_slices, number, is_reference)

    def _slice(self, codec: Codec, unit: int, data: bytes) -> tuple[int, int | None]:
        """Return type and frame number in the header of a slice; -1 and None if they are not there.

        In H.265 a flag comes first, and it is read of the first slice of a picture without extensions only; key frames have no
        other slices than those without references.
        """
        bits = _Bits(data[1 if codec == "h264" else 2 :])
        try:
            if codec == "hevc":
                if unit in _KEY[codec] or not bits.number(1):
                    return -1, None
                bits.golomb()
                return bits.golomb(), None
            if unit not in {1, 5}:
                return -1, None
            bits.golomb()
            slice_type = bits.golomb()
            bits.golomb()
            width = self.frame_numbers.bit_length() - 1
            return slice_type, bits.number(width) if self.frame_numbers else None
        except ValueError:
            return -1, None


def _of_av1(data: bytes) -> Units:
    """Return what the OBUs of a temporal unit say; it shows one picture, however many frames it has.

    Raises:
        DecodeError: they are not as long as they say.
    """
    at, heads = 0, list[int]()
    try:
        while at < len(data):
            head, at = data[at], at + 1 + (data[at] >> 2 & 1)  # an extension of a byte
            size, at = _size_at(data, at) if head & 2 else (len(data) - at, at)
            end = at + size
            if head >> 7 or end > len(data):
                raise DecodeError(_NOT_AV1)
            if head >> 3 & 15 in _FRAMES:
                heads.append(data[at:end][0])
            at = end
    except IndexError as err:
        raise DecodeError(_NOT_AV1) from err
    # Not one shown before, a key frame, shown: what a key frame leaves for later is shown by another packet.
    return Units(bool(heads), any(one >> 4 == 1 for one in heads))


def _size_at(data: bytes, at: int) -> tuple[int, int]:
    """Return a number of at most eight bytes of seven bits (LEB128, 4.10.5), and where it ends; IndexError if it does not."""
    size = 0
    for number, byte in enumerate(data[at : at + 8]):
        size |= (byte & 127) << 7 * number
        if byte < 128:
            return size, at + number + 1
    raise IndexError("the end")


def _of_vp9(data: bytes) -> Units:
    """Return what the first frame says, which hidden ones may follow.

    Raises:
        DecodeError: it is none.
    """
    if not data or data[0] >> 6 != 2:
        raise DecodeError("its video is not a frame of VP9")
    profile = data[0] >> 5 & 1 | data[0] >> 3 & 2
    flags = data[0] >> (1 if profile == 3 else 2)  # shown before, no key frame
    return Units(has_picture=True, is_key=flags & 3 == 0)


def _frame_numbers(parameters: bytes) -> int:
    """Return how many frame numbers a sequence parameter set has; 0 if that is hard to find out, or they may have gaps."""
    bits = _Bits(parameters.replace(b"\0\0\3", b"\0\0"))
    try:
        profile = bits.number(8)
        bits.number(16)
        bits.golomb()
        if profile in _HIGH:
            separate = bits.golomb() == 3 and bits.number(1)
            bits.golomb()
            bits.golomb()
            bits.number(1)
            if separate or bits.number(1):  # scaling matrices follow
                return 0
        if (log2 := bits.golomb() + 4) > _MOST_LOG2:
            return 0
        order = bits.golomb()
        if order == 0:
            bits.golomb()
        elif order == 1:
            return 0
        bits.golomb()
        return 0 if bits.number(1) else 1 << log2
    except ValueError:
        return 0


class _Bits:
    """Bits of a header, read from the front; ValueError at their end."""

    def __init__(self, data: bytes) -> None:
        self._bits = "".join(f"{byte:08b}" for byte in data)
        self._at = 0

    def number(self, width: int) -> int:
        """Return an unsigned number of some bits."""
        taken = self._bits[self._at : self._at + width]
        if len(taken) < width:
            raise ValueError("the end")
        self._at += width
        return int(taken or "0", 2)

    def golomb(self) -> int:
        """Return an Exp-Golomb code, unsigned."""
        zeros = self._bits.index("1", self._at) - self._at
        self._at += zeros
        return self.number(zeros + 1) - 1
