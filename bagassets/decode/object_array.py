"""`derived_object_msgs/ObjectArray`: tracked objects with a class and a shape."""

from collections.abc import Sequence

from bagassets.decode.boxes import BoxDecoder
from bagassets.decode.fields import rigid_transform, stamp_and_frame
from bagassets.decode.model import BoxReading
from bagassets.errors import DecodeError
from bagassets.recordings.model import Message

__all__ = ["OBJECTS", "decode_object", "items"]

# derived_object_msgs/Object CLASSIFICATION_*
CLASSES = (
    "unknown",
    "unknown_small",
    "unknown_medium",
    "unknown_big",
    "pedestrian",
    "bike",
    "car",
    "truck",
    "motorcycle",
    "other_vehicle",
    "barrier",
    "sign",
)
BOX = 1  # shape_msgs/SolidPrimitive


def items(message: Message) -> Sequence[Message]:
    """Return the objects of an `ObjectArray`."""
    objects: Sequence[Message] = message.objects
    return objects


def decode_object(message: Message, item: Message) -> BoxReading:
    """Return the box of an `Object`; its class is the lower-case name of the classification.

    Raises:
        DecodeError: the shape is no box, or the pose is not usable.
    """
    if item.shape.type != BOX or len(item.shape.dimensions) < 3:
        raise DecodeError("its object has no box as shape")
    stamp_ns, frame_id = stamp_and_frame(item.header)
    array_stamp_ns, array_frame_id = stamp_and_frame(message.header)
    length, width, height = (float(value) for value in item.shape.dimensions[:3])
    label = int(item.classification)
    return BoxReading(
        stamp_ns=stamp_ns or array_stamp_ns,
        frame_id=frame_id or array_frame_id,
        frame_SE3_box=rigid_transform(item.pose.position, item.pose.orientation),
        size_m=(width, length, height),
        track_id=str(int(item.id)),
        category=CLASSES[label] if label < len(CLASSES) else f"class_{label}",
        score=int(item.classification_certainty) / 255,
    )


OBJECTS = BoxDecoder(items, decode_object)
