"""Which message types carry 3-D boxes, and how each of them is taken apart.

A message is split into its items first and each item decoded by itself, so that one box that
is nonsense does not cost the others.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from bagassets.decode import autoware_objects, bounding_boxes, detection3d, markers, object_array
from bagassets.decode.model import BoxReading

__all__ = ["BoxDecoder", "box_decoder", "box_message_types"]


@dataclass(frozen=True)
class BoxDecoder:
    """How boxes are read from one message type.

    Attributes:
        items: message -> its items in order.
        decode: (message, item) -> box; None if the item is no box at all.
            Raises DecodeError if it is a box that cannot be used. `source` of the box stays empty.
    """

    items: Callable[[Any], Iterable[Any]]
    decode: Callable[[Any, Any], BoxReading | None]


_DETECTIONS = BoxDecoder(detection3d.items, detection3d.decode_detection)
_OBJECTS = BoxDecoder(autoware_objects.items, autoware_objects.decode_object)
_DECODERS = {
    "vision_msgs/msg/Detection3DArray": _DETECTIONS,
    "visualization_msgs/msg/Marker": BoxDecoder(markers.single_item, markers.decode_marker),
    "visualization_msgs/msg/MarkerArray": BoxDecoder(markers.items, markers.decode_marker),
    "derived_object_msgs/msg/ObjectArray": BoxDecoder(object_array.items, object_array.decode_object),
    "jsk_recognition_msgs/msg/BoundingBoxArray": BoxDecoder(bounding_boxes.items, bounding_boxes.decode_box),
    **{
        f"{package}/msg/{name}": _OBJECTS
        for package in ("autoware_perception_msgs", "autoware_auto_perception_msgs")
        for name in ("DetectedObjects", "TrackedObjects")
    },
}


def box_decoder(msgtype: str) -> BoxDecoder | None:
    """Return the decoder for a message type `pkg/msg/Type`, or None if it carries no boxes we know."""
    return _DECODERS.get(msgtype)


def box_message_types() -> tuple[str, ...]:
    """Return the message types that boxes are read from, sorted."""
    return tuple(sorted(_DECODERS))
