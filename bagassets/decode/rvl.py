"""RVL, a lossless compression of depth that `compressedDepth` may use instead of PNG.

By turns there is a run of zeros and one of other values; each begins with its length, and values are given as differences
to the last one. All are numbers of three bits a digit, the lowest first, in which a fourth bit says that more follow
(source: Wilson, Fast Lossless Depth Image Compression, ISS 2017). Eight digits make a word of 32 bit, the first one on top.
"""

import struct

import numpy as np
from numpy.typing import NDArray

from bagassets.base.errors import DecodeError

# Width and height, as compressed_depth_image_transport writes them before the first word.
_SIZE = struct.Struct("<II")
_SHIFTS = np.arange(28, -1, -4, dtype=np.uint32)
_MOST_DIGITS = 11  # of 32 bit


def rvl_size(data: memoryview | bytes) -> tuple[int, int]:
    """Return width and height of an image.

    Raises:
        DecodeError: it has none.
    """
    if len(data) < _SIZE.size:
        raise DecodeError("the RVL is cut off")
    width, height = _SIZE.unpack_from(data)
    if not width or not height:
        raise DecodeError("the RVL has no pixels")
    return width, height


def decode_rvl(data: memoryview | bytes) -> NDArray[np.uint16]:
    """Return the (H, W) levels of an image whose size has been checked.

    Raises:
        DecodeError: it is cut off or damaged.
    """
    width, height = rvl_size(data)
    numbers = _numbers(data[_SIZE.size :])
    levels = np.zeros(height * width, np.uint16)
    deltas = np.zeros(len(numbers), bool)
    at = number = 0
    while at < len(levels):
        if number + 1 >= len(numbers):
            raise DecodeError("the RVL is cut off")
        begin = at + int(numbers[number])
        length = int(numbers[number + 1])
        at, first, number = begin + length, number + 2, number + 2 + length
        if number > len(numbers):
            raise DecodeError("the RVL is cut off")
        if at > len(levels):
            raise DecodeError("the RVL has more pixels than its size says")
        levels[begin:at] = 1
        deltas[first:number] = True
    signed = numbers[deltas]
    # Sums wrap around at 16 bit, as those of the encoder do.
    levels[levels > 0] = np.cumsum((signed >> 1) ^ -(signed & 1)).astype(np.uint16)
    return levels.reshape(height, width)


def _numbers(data: memoryview | bytes) -> NDArray[np.int64]:
    """Return all numbers in whole words, the last few of which may be padding."""
    words = np.frombuffer(data, "<u4", count=len(data) // 4)
    digits = ((words[:, None] >> _SHIFTS) & 0xF).astype(np.uint8).ravel()
    ends = np.flatnonzero(digits < 8)
    begins = np.concatenate([[0], ends[:-1] + 1]) if len(ends) else ends
    lengths = ends - begins + 1
    if len(lengths) and lengths.max() > _MOST_DIGITS:
        raise DecodeError("the RVL has a number of more than 32 bit")
    numbers = np.zeros(len(ends), np.int64)
    for place in range(int(lengths.max(initial=0))):
        longer = np.flatnonzero(lengths > place)
        numbers[longer] |= (digits[begins[longer] + place].astype(np.int64) & 7) << 3 * place
    return numbers
