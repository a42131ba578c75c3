"""The interface of box decoders.

A message is split into items first, and each item is decoded by itself, so that one bad box does not cost the others.
Objects of other shapes have a box, too: their extent along the axes of the object.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import pairwise
from math import isfinite

from bagassets.base.errors import DecodeError
from bagassets.decode.model import BoxReading
from bagassets.geometry.se3 import SE3
from bagassets.recordings.model import Message

NO_EXTENT = "its object has a shape without an extent"


@dataclass(frozen=True)
class BoxDecoder:
    """Reads boxes from one message type.

    Attributes:
        items: message -> its items in order.
        decode: (message, item) -> box, whose `source` stays empty; None if the item is not a box.
            Raises DecodeError for an unusable box.
    """

    items: Callable[[Message], Iterable[Message]]
    decode: Callable[[Message, Message], BoxReading | None]


def box_around(
    frame_SE3_object: SE3, footprint: Message, height_m: float
) -> tuple[SE3, tuple[float, float, float]]:
    """Return the box around a prism, half of which lies below the origin of its object.

    Args:
        frame_SE3_object: pose of the object.
        footprint: `geometry_msgs/Polygon` in the frame of the object, of which x and y in metres count.
        height_m: along z.

    Returns:
        `frame_SE3_box`, and width (y), length (x), height (z) in metres.

    Raises:
        DecodeError: the points do not enclose an area.
    """
    points = [(float(point.x), float(point.y)) for point in footprint.points]
    from_first = [(x - points[0][0], y - points[0][1]) for x, y in points]
    area_m2 = sum(abs(ax * by - bx * ay) for (ax, ay), (bx, by) in pairwise(from_first)) / 2
    if not (isfinite(area_m2) and area_m2 > 0):
        raise DecodeError("the footprint of its object has no area")
    (first_x, last_x), (first_y, last_y) = ((min(axis), max(axis)) for axis in zip(*points, strict=True))
    middle = SE3(translation=((first_x + last_x) / 2, (first_y + last_y) / 2, 0.0))
    return frame_SE3_object @ middle, (last_y - first_y, last_x - first_x, height_m)
