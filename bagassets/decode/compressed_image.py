"""`sensor_msgs/CompressedImage`: JPEG and PNG, told apart by their bytes.

`format` is free text. What image_transport writes is `<encoding of the camera>; jpeg compressed <encoding that
was compressed>`, and its subscriber reads it back as follows (compressed_image_transport, publisher and
subscriber):

* after `compressed bgr8` the file is as any viewer shows it;
* after `compressed rgb8`, and in recordings of before 2013 that name no second encoding for a colour camera, red and
  blue of the file are exchanged: RGB was handed to an encoder that takes BGR;
* a Bayer camera without a second encoding, or with a Bayer pattern for it, was compressed as a mosaic.

Any other text (`jpeg`, `png`) leaves the file as any viewer shows it.
"""

import re
import struct
from typing import Any

import cv2
import numpy as np

from bagassets.decode.fields import stamp_and_frame
from bagassets.decode.image import Pixels, demosaic
from bagassets.decode.model import ImageReading
from bagassets.errors import DecodeError

__all__ = ["decode_compressed_image", "image_size", "unpack"]

_JPEG, _PNG = b"\xff\xd8\xff", b"\x89PNG\r\n\x1a\n"
_USUAL_PADDING = 4096
_BAYER = re.compile(r"bayer_[rgb]{4}(8|16)")
_COLOUR = re.compile(r"\s*(rgb|bgr)a?(8|16)\s*;")


def decode_compressed_image(message: Any) -> ImageReading:
    """Return the image with the bytes as recorded; `encoding` is `jpeg` or `png`.

    If the pixels inside are not what a viewer shows, it goes on with a colon and what they are: `rgb`, or
    the Bayer pattern. The type is told from the first bytes, since `format` is often empty and sometimes
    wrong. The bytes are a view of the message's.

    Raises:
        DecodeError: it is neither a JPEG nor a PNG, or it is cut off.
    """
    stamp_ns, frame_id = stamp_and_frame(message.header)
    said = str(message.format)
    if "compressedDepth" in said:
        raise DecodeError("compressedDepth images are not supported; record the raw depth topic")
    data = np.ascontiguousarray(message.data, np.uint8).data
    start = bytes(data[: len(_PNG)])
    if start.startswith(_JPEG):
        kind = "jpeg"
        # Decoders fill the missing part of a cut-off JPEG with grey; drivers pad whole ones with zeros.
        if not _without_padding(data).endswith(b"\xff\xd9"):
            raise DecodeError("the JPEG is cut off")
    elif start == _PNG:
        kind = "png"
        if b"IEND" not in bytes(data[-1024:]):
            raise DecodeError("the PNG is cut off")
    else:
        raise DecodeError(f"format '{said}' is neither JPEG nor PNG by its first bytes")
    inside = _inside(said)
    return ImageReading(stamp_ns, frame_id, None, data, f"{kind}:{inside}" if inside else kind)


def _inside(said: str) -> str:
    """Return what `format` says of the pixels inside: a Bayer pattern, rgb, or nothing if they are as usual."""
    recorded, told, inside = said.rpartition("compressed")
    inside = inside.strip()
    # Without a second encoding, the first one says what was compressed.
    pattern = _BAYER.search(inside or recorded)
    if pattern is not None:
        return pattern.group(0)
    if not told:
        return ""
    swapped = inside.startswith("rgb") or (not inside and _COLOUR.match(recorded))
    return "rgb" if swapped else ""


def _without_padding(data: memoryview) -> bytes:
    """Return the last bytes that are not zeros appended to the rest."""
    end = bytes(data[-_USUAL_PADDING:]).rstrip(b"\x00")
    return end if len(end) > 1 else bytes(data).rstrip(b"\x00")


def unpack(encoded: bytes | memoryview, encoding: str) -> Pixels:
    """Return the pixels, (H, W) grey or (H, W, 3) BGR, uint8 or uint16.

    Raises:
        DecodeError: the bytes do not decode.
    """
    pixels = cv2.imdecode(np.frombuffer(encoded, np.uint8), cv2.IMREAD_UNCHANGED)
    if pixels is None:
        raise DecodeError(f"the {encoding.partition(':')[0].upper()} does not decode")
    if pixels.ndim == 3 and pixels.shape[2] == 4:
        pixels = pixels[:, :, :3]
    inside = encoding.partition(":")[2]
    if inside == "rgb" and pixels.ndim == 3:
        pixels = pixels[:, :, ::-1]
    if inside in {"", "rgb"}:
        return np.ascontiguousarray(pixels)
    return demosaic(np.ascontiguousarray(pixels if pixels.ndim == 2 else pixels[:, :, 0]), inside)


def image_size(encoded: bytes | memoryview) -> tuple[int, int]:
    """Return width and height from the header of a JPEG or PNG, without decoding it.

    Raises:
        DecodeError: there is no such header.
    """
    if encoded[: len(_PNG)] == _PNG:
        width, height = struct.unpack(">II", encoded[16:24])
        return width, height
    at = 2
    while at + 9 < len(encoded):
        marker = encoded[at + 1]
        # SOF0-SOF15 hold the size, except DHT, JPG and DAC in between (ITU T.81, table B.1).
        if 0xC0 <= marker <= 0xCF and marker not in {0xC4, 0xC8, 0xCC}:
            height, width = struct.unpack(">HH", encoded[at + 5 : at + 9])
            return width, height
        at += 2 + struct.unpack(">H", encoded[at + 2 : at + 4])[0]
    raise DecodeError("the JPEG has no frame header")
