"""`sensor_msgs/Image` and `foxglove.RawImage`: raw pixels in the encodings of sensor_msgs/image_encodings.hpp."""

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from bagassets.base.errors import DecodeError
from bagassets.decode.fields import byte_array, head
from bagassets.decode.model import ImageReading
from bagassets.geometry.undistortion import Pixels
from bagassets.recordings.model import Message


@dataclass(frozen=True, slots=True)
class _Encoding:
    channels: int
    bytes_per_channel: int
    conversion: int | None


# OpenCV names a Bayer pattern by the second row's second and third pixel, ROS by the first two
# of the first row: RGGB in ROS is what OpenCV calls BG.
_OF_OPENCV = {"rggb": "BG", "bggr": "RG", "gbrg": "GR", "grbg": "GB"}
_BAYER: Mapping[str, int] = {ros: getattr(cv2, f"COLOR_Bayer{own}2BGR") for ros, own in _OF_OPENCV.items()}
_BAYER_TO_BGRA: Mapping[str, int] = {
    f"bayer_{ros}8": getattr(cv2, f"COLOR_Bayer{own}2BGRA") for ros, own in _OF_OPENCV.items()
}
ENCODINGS: Mapping[str, _Encoding] = {
    "rgb8": _Encoding(3, 1, cv2.COLOR_RGB2BGR),
    "bgr8": _Encoding(3, 1, None),
    "8uc3": _Encoding(3, 1, None),
    "rgba8": _Encoding(4, 1, cv2.COLOR_RGBA2BGR),
    "bgra8": _Encoding(4, 1, cv2.COLOR_BGRA2BGR),
    "mono8": _Encoding(1, 1, None),
    "8uc1": _Encoding(1, 1, None),
    "mono16": _Encoding(1, 2, None),
    "16uc1": _Encoding(1, 2, None),
    "32fc1": _Encoding(1, 4, None),
    "yuv422": _Encoding(2, 1, cv2.COLOR_YUV2BGR_UYVY),
    "uyvy": _Encoding(2, 1, cv2.COLOR_YUV2BGR_UYVY),
    "yuv422_yuy2": _Encoding(2, 1, cv2.COLOR_YUV2BGR_YUY2),
    "yuyv": _Encoding(2, 1, cv2.COLOR_YUV2BGR_YUY2),
    **{f"bayer_{name}8": _Encoding(1, 1, code) for name, code in _BAYER.items()},
    **{f"bayer_{name}16": _Encoding(1, 2, code) for name, code in _BAYER.items()},
}
# Rows of luma, and below them half as many rows in which the two chromas alternate, each for four pixels.
_CHROMA_BELOW = {"nv12": cv2.COLOR_YUV2BGR_NV12, "nv21": cv2.COLOR_YUV2BGR_NV21}


def decode_image(message: Message) -> ImageReading:
    """Return the image with its pixels as recorded: a view of the message, not yet converted, but for NV12 and NV21.

    Raises:
        DecodeError: the encoding is unknown, or the size does not fit the data.
    """
    stamp_ns, frame_id = head(message)
    encoding = str(message.encoding).lower()
    conversion = _CHROMA_BELOW.get(encoding)
    layout = ENCODINGS.get(encoding if conversion is None else "mono8")
    if layout is None:
        raise DecodeError(f"image encoding '{message.encoding}' is not supported")
    width, height, step = int(message.width), int(message.height), int(message.step)
    data = byte_array(message.data)
    row_bytes = width * layout.channels * layout.bytes_per_channel
    lines = height if conversion is None else height + height // 2
    if step == 0 and len(data) == lines * row_bytes:  # several drivers leave it zero
        step = row_bytes
    is_whole = width and height and step >= row_bytes and len(data) >= (lines - 1) * step + row_bytes
    # Where more follows, nothing says at which row the chroma begins.
    if not is_whole or (conversion is not None and (width % 2 or height % 2 or len(data) > lines * step)):
        raise DecodeError(
            f"an image of {width}x{height} in {encoding} with step {step} does not fit {len(data)} bytes"
        )
    # The last row may end with its last pixel, without padding.
    rows = np.ndarray((lines, row_bytes), np.uint8, data, strides=(step, 1))
    if conversion is not None:
        colours: Pixels = cv2.cvtColor(np.ascontiguousarray(rows), conversion)
        return ImageReading(stamp_ns, frame_id, colours, None, "bgr8")
    pixels: Pixels | NDArray[np.float32] = rows
    if layout.bytes_per_channel == 2:
        order = ">u2" if getattr(message, "is_bigendian", False) else "<u2"
        pixels = np.ascontiguousarray(rows).view(order).astype(np.uint16, copy=False)
    elif layout.bytes_per_channel == 4:
        order = ">f4" if getattr(message, "is_bigendian", False) else "<f4"
        pixels = np.ascontiguousarray(rows).view(order).astype(np.float32, copy=False)
    if layout.channels > 1:
        pixels = pixels.reshape(height, width, layout.channels)
    return ImageReading(stamp_ns, frame_id, pixels, None, encoding)


def check_pixels(width: int, height: int, most_pixels: int) -> None:
    """Check the size of an image before memory is allocated for it.

    Raises:
        DecodeError: it has more than `most_pixels`.
    """
    if width * height > most_pixels:
        raise DecodeError("it has more pixels than limits.image_pixels in the recipe allows")


def to_bgr_or_grey(pixels: Pixels, encoding: str) -> Pixels:
    """Convert pixels as recorded to (H, W) grey or (H, W, 3) BGR of the same depth."""
    conversion = ENCODINGS[encoding].conversion
    if conversion is None:
        return pixels
    return cv2.cvtColor(np.ascontiguousarray(pixels), conversion)


def bayer_to_bgra(pixels: Pixels, encoding: str) -> Pixels | None:
    """Convert an 8-bit Bayer mosaic to (H, W, 4) BGRA, with the colours of `demosaic`; None for other images.

    Four channels are resampled faster than three.
    """
    conversion = _BAYER_TO_BGRA.get(encoding)
    return None if conversion is None else cv2.cvtColor(np.ascontiguousarray(pixels), conversion)


def demosaic(mosaic: Pixels, encoding: str) -> Pixels:
    """Convert a (H, W) Bayer mosaic, as some compressed images hold, to (H, W, 3) BGR."""
    pattern = encoding.lower().removeprefix("bayer_").rstrip("0123456789")
    if pattern not in _BAYER:
        raise DecodeError(f"Bayer pattern '{encoding}' is not known")
    return cv2.cvtColor(mosaic, _BAYER[pattern])
