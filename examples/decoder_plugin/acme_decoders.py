"""`acme_msgs/RawFrame`: a Bayer mosaic as the camera's MIPI bus packs it, in RAW10.

The message::

    std_msgs/Header header
    uint32 width
    uint32 height
    uint8[] data
"""

from typing import Any

import numpy as np

from bagassets.decode.fields import stamp_and_frame
from bagassets.decode.model import ImageReading
from bagassets.errors import DecodeError

__all__ = ["decode_raw_frame"]


def decode_raw_frame(message: Any) -> ImageReading:
    """Return the mosaic; bagassets makes it colour, undistorts it and writes it.

    RAW10 packs four pixels into five bytes: their high eight bits each, then their low two bits
    together. A training image keeps the high ones.

    Raises:
        DecodeError: the size does not fit the data.
    """
    width, height = int(message.width), int(message.height)
    if width % 4 or len(message.data) != width * height * 5 // 4:
        raise DecodeError("its data are not a RAW10 frame of the size that it gives")
    stamp_ns, frame_id = stamp_and_frame(message.header)
    groups = np.asarray(message.data).reshape(-1, 5)
    pixels = np.ascontiguousarray(groups[:, :4]).reshape(height, width)
    return ImageReading(stamp_ns, frame_id, pixels, None, "bayer_rggb8")
