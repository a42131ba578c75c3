"""Depth images: `32FC1` in metres, and `compressedDepth`, a PNG or RVL behind a header of 12 bytes (compressed_depth_image_transport).

In the latter, depth of 16 bit is as it was, mostly in millimetres (REP 118); depth in metres is quantised by its inverse,
finely near the camera, and the header has the two numbers for the way back.
"""

import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bagassets.base.errors import DecodeError
from bagassets.decode.image_structure import PNG

_HEADER = struct.Struct("<iff")  # kind of compression, and the parameters A and B
_MOST_STEPS = 65535


def compressed_depth(text: str, data: memoryview) -> tuple[memoryview, str]:
    """Return the PNG or RVL in a `compressedDepth` message, and its encoding for `ImageReading`.

    Args:
        text: `format` of the message, which begins with the encoding of the raw image.
        data: bytes of the message.

    Raises:
        DecodeError: it is neither, or of another kind of image.
    """
    image = data[_HEADER.size :]
    is_png = bytes(image[: len(PNG)]) == PNG
    recorded, _, how = text.partition(";")
    if not is_png and not how.rstrip().endswith("rvl"):
        raise DecodeError(f"format '{text}' is neither PNG by its first bytes nor RVL")
    kind = recorded.strip().upper()
    if kind in {"16UC1", "MONO16"}:
        return image, "png" if is_png else "rvl:"  # the colon, as viewers do not show it
    if kind != "32FC1":
        raise DecodeError(f"compressedDepth of '{recorded.strip()}' is not supported (16UC1 and 32FC1 are)")
    _, a, b = _HEADER.unpack(data[: _HEADER.size])
    return image, f"{'png' if is_png else 'rvl'}:depth:{a!r}:{b!r}"


def metres(inside: str, quantised: NDArray[Any]) -> NDArray[np.float32]:
    """Return (H, W) depth in metres, NaN where there is none, from the levels in a file and what `compressed_depth` says is inside.

    Raises:
        DecodeError: the PNG does not hold 16-bit grey.
    """
    if quantised.ndim != 2 or quantised.dtype != np.uint16:
        raise DecodeError("the PNG of its compressedDepth is not 16-bit grey")
    a, b = (np.float32(text) for text in inside.split(":")[1:])
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = a / (quantised.astype(np.float32) - b)
    return np.where(quantised > 0, depth, np.float32(np.nan))


@dataclass(frozen=True, slots=True)
class DepthLosses:
    """Pixels of depth images that have none.

    Attributes:
        without: no depth was measured: zero, negative, or not finite.
        out_of_range: it does not fit into 16 bit in the unit of the channel.
    """

    without: int = 0
    out_of_range: int = 0

    def __add__(self, other: "DepthLosses") -> "DepthLosses":
        return DepthLosses(self.without + other.without, self.out_of_range + other.out_of_range)


def in_steps(depth_m: NDArray[np.float32], unit_m: float) -> tuple[NDArray[np.uint16], DepthLosses]:
    """Return (H, W) depth in steps of a unit, 0 where there is none, and how many pixels that are."""
    with np.errstate(invalid="ignore", over="ignore"):
        there = np.isfinite(depth_m) & (depth_m > 0)
        steps = np.rint(np.where(there, depth_m, 0).astype(np.float64) / unit_m)
    fits = (steps >= 1) & (steps <= _MOST_STEPS)
    without = depth_m.size - int(np.count_nonzero(there))
    losses = DepthLosses(without, int(np.count_nonzero(there & ~fits)))
    return np.where(fits, steps, 0).astype(np.uint16), losses
