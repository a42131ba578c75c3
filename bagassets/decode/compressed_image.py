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

import cv2
import numpy as np

from bagassets.decode.fields import stamp_and_frame
from bagassets.decode.image import Pixels, demosaic
from bagassets.decode.image_structure import JPEG, PNG, check_jpeg, check_png
from bagassets.decode.model import ImageReading
from bagassets.errors import DecodeError
from bagassets.recordings.model import Message

__all__ = ["checked_size", "decode_compressed_image", "unpack", "unpack_checked"]

_BAYER = re.compile(r"bayer_[rgb]{4}(8|16)")
_COLOUR = re.compile(r"\s*(rgb|bgr)a?(8|16)\s*;")


def decode_compressed_image(message: Message) -> ImageReading:
    """Return the image with the bytes as recorded; `encoding` is `jpeg` or `png`.

    If the pixels inside are not what a viewer shows, it goes on with a colon and what they are: `rgb`, or
    the Bayer pattern. The type is told from the first bytes, since `format` is often empty and sometimes
    wrong. The bytes are a view of the message's; `checked_size` and `unpack` tell whether they are whole.

    Raises:
        DecodeError: it is neither a JPEG nor a PNG.
    """
    stamp_ns, frame_id = stamp_and_frame(message.header)
    said = str(message.format)
    if "compressedDepth" in said:
        raise DecodeError("compressedDepth images are not supported; record the raw depth topic")
    data = np.ascontiguousarray(message.data, np.uint8).data
    start = bytes(data[: len(PNG)])
    if start.startswith(JPEG):
        kind = "jpeg"
    elif start == PNG:
        kind = "png"
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


def checked_size(encoded: memoryview | bytes, encoding: str) -> tuple[int, int]:
    """Return width and height of a JPEG or PNG, which is not decoded.

    Raises:
        DecodeError: it is cut off or damaged.
    """
    check = check_png if encoding.startswith("png") else check_jpeg
    return check(memoryview(encoded))


def unpack(encoded: bytes | memoryview, encoding: str) -> Pixels:
    """Return the pixels, (H, W) grey or (H, W, 3) BGR, uint8 or uint16.

    Raises:
        DecodeError: the bytes are cut off or damaged, or do not decode.
    """
    checked_size(encoded, encoding)
    return unpack_checked(encoded, encoding)


def unpack_checked(encoded: bytes | memoryview, encoding: str) -> Pixels:
    """Return the pixels as `unpack` does, of a file whose size `checked_size` told.

    OpenCV fills what is missing with grey, and makes room for whatever size the header says.

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
