"""`sensor_msgs/CompressedImage`: JPEG and PNG, recognized by their bytes.

`format` is free text. image_transport writes `<encoding of the camera>; jpeg compressed <encoding that was compressed>`,
and its subscriber reads that as follows (source: compressed_image_transport):

* with `compressed bgr8`, viewers show the file correctly;
* with `compressed rgb8`, and in recordings from before 2013 without a second encoding for a colour camera, red and blue
  are swapped in the file: RGB was passed to an encoder for BGR;
* from a Bayer camera without a second encoding, or with a Bayer pattern as such, the file holds the mosaic.

With any other text (`jpeg`, `png`), viewers show the file correctly.
"""

import re
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from bagassets.base.errors import DecodeError
from bagassets.decode.depth import compressed_depth, metres
from bagassets.decode.fields import byte_array, head
from bagassets.decode.image import demosaic
from bagassets.decode.image_structure import JPEG, PNG, check_jpeg, check_png
from bagassets.decode.model import ImageReading
from bagassets.decode.rvl import decode_rvl, rvl_size
from bagassets.geometry.undistortion import Pixels
from bagassets.recordings.model import Message

_BAYER = re.compile(r"bayer_[rgb]{4}(8|16)")
_COLOUR = re.compile(r"\s*(rgb|bgr)a?(8|16)\s*;")


def decode_compressed_image(message: Message) -> ImageReading:
    """Return the image with the bytes as recorded; `encoding` is `jpeg` or `png`, of depth also `rvl`.

    If viewers would show the wrong colours, a colon and the layout of the pixels follow: `rgb`, or the Bayer
    pattern. The first bytes decide between JPEG and PNG, because `format` is often empty and sometimes wrong. The bytes are a view of the message's; `checked_size` finds out whether they are whole.

    Raises:
        DecodeError: it is neither a JPEG nor a PNG, or `compressedDepth` of another kind than 16 bit or metres as PNG or RVL.
    """
    stamp_ns, frame_id = head(message)
    text = str(message.format)
    data = byte_array(message.data).data
    if "compressedDepth" in text:
        image, encoding = compressed_depth(text, data)
        return ImageReading(stamp_ns, frame_id, None, image, encoding)
    start = bytes(data[: len(PNG)])
    kind = "jpeg" if start.startswith(JPEG) else "png" if start == PNG else ""
    if not kind:
        raise DecodeError(f"format '{text}' is neither JPEG nor PNG by its first bytes")
    inside = _inside(text)
    return ImageReading(stamp_ns, frame_id, None, data, f"{kind}:{inside}" if inside else kind)


def _inside(text: str) -> str:
    """Return the layout of the pixels according to `format`: a Bayer pattern, `rgb`, or "" for BGR or grey."""
    recorded, separator, inside = text.rpartition("compressed")
    inside = inside.strip()
    # Without a second encoding, the first one says what was compressed.
    pattern = _BAYER.search(inside or recorded)
    if pattern is not None:
        return pattern.group(0)
    if not separator:
        return ""
    swapped = inside.startswith("rgb") or (not inside and _COLOUR.match(recorded))
    return "rgb" if swapped else ""


def checked_size(encoded: memoryview | bytes, encoding: str) -> tuple[int, int]:
    """Return width and height of a JPEG, PNG or RVL without decoding it.

    Raises:
        DecodeError: it is cut off or damaged, which of an RVL only decoding finds out.
    """
    check = {"png": check_png, "rvl": rvl_size}.get(encoding.partition(":")[0], check_jpeg)
    return check(memoryview(encoded))


def decode_pixels(encoded: bytes | memoryview, encoding: str) -> Pixels | NDArray[np.float32]:
    """Return the pixels of a file that passed `checked_size`, (H, W) grey or (H, W, 3) BGR, uint8 or uint16; or depth in metres.

    Check the file first: OpenCV fills missing parts with grey, and allocates any size that the header announces.

    Raises:
        DecodeError: the bytes do not decode.
    """
    kind, _, inside = encoding.partition(":")
    pixels: NDArray[Any] | None = (
        decode_rvl(encoded)
        if kind == "rvl"
        else cv2.imdecode(np.frombuffer(encoded, np.uint8), cv2.IMREAD_UNCHANGED)
    )
    if pixels is None:
        raise DecodeError(f"the {kind.upper()} does not decode")
    if pixels.ndim == 3 and pixels.shape[2] == 4:
        pixels = pixels[:, :, :3]
    if inside.startswith("depth"):
        return metres(inside, pixels)
    if inside == "rgb" and pixels.ndim == 3:
        pixels = pixels[:, :, ::-1]
    if inside in {"", "rgb"}:
        return np.ascontiguousarray(pixels)
    return demosaic(np.ascontiguousarray(pixels if pixels.ndim == 2 else pixels[:, :, 0]), inside)
