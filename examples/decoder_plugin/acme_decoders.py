"""`acme_msgs/RawFrame`: a Bayer mosaic in RAW10, as packed on the camera's MIPI bus.

The message::

    std_msgs/Header header
    uint32 width
    uint32 height
    uint8[] data
"""

from typing import Any

import numpy as np

from bagassets.base.errors import DecodeError
from bagassets.decode.fields import stamp_and_frame
from bagassets.decode.model import ImageReading

__all__ = ["decode_raw_frame"]


def decode_raw_frame(message: Any) -> ImageReading:
    """Return the mosaic; bagassets demosaics, undistorts and writes it.

    RAW10 packs four pixels into five bytes: the high eight bits of each, then the low two bits of all. Training images
    need the high bits only.

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
