"""`derived_object_msgs/ObjectArray`: tracked objects with a class and a shape."""

from operator import attrgetter

from bagassets.base.errors import DecodeError
from bagassets.decode.boxes import NO_EXTENT, BoxDecoder, box_around
from bagassets.decode.fields import rigid_transform, stamp_and_frame
from bagassets.decode.model import BoxReading
from bagassets.geometry.se3 import SE3
from bagassets.recordings.model import Message

__all__ = ["OBJECTS", "decode_object"]

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
BOX, SPHERE, CYLINDER, PRISM = 1, 2, 3, 5  # shape_msgs/SolidPrimitive


def decode_object(message: Message, item: Message) -> BoxReading:
    """Return the box of an `Object`; its class is the lower-case name of the classification.

    Raises:
        DecodeError: the shape has no extent, or the pose is not usable.
    """
    frame_SE3_object = rigid_transform(item.pose.position, item.pose.orientation)
    frame_SE3_box, size_m = _box(frame_SE3_object, item.shape)
    stamp_ns, frame_id = stamp_and_frame(item.header, message.header)
    label = int(item.classification)
    return BoxReading(
        stamp_ns=stamp_ns,
        frame_id=frame_id,
        frame_SE3_box=frame_SE3_box,
        size_m=size_m,
        track_id=str(int(item.id)),
        category=CLASSES[label] if label < len(CLASSES) else f"class_{label}",
        score=int(item.classification_certainty) / 255,
    )


def _box(frame_SE3_object: SE3, shape: Message) -> tuple[SE3, tuple[float, float, float]]:
    """Return `frame_SE3_box`, and width, length, height in metres.

    Where the origin of a cone is, its definition leaves open.
    """
    match int(shape.type), [float(value) for value in shape.dimensions]:
        case (kind, [length, width, height, *_]) if kind == BOX:
            return frame_SE3_object, (width, length, height)
        case (kind, [radius, *_]) if kind == SPHERE:
            return frame_SE3_object, (2 * radius,) * 3
        case (kind, [height, radius, *_]) if kind == CYLINDER:
            return frame_SE3_object, (2 * radius, 2 * radius, height)
        case (kind, [height, *_]) if kind == PRISM and hasattr(shape, "polygon"):  # since Humble
            return box_around(frame_SE3_object, shape.polygon, height)
    raise DecodeError(NO_EXTENT)


OBJECTS = BoxDecoder(attrgetter("objects"), decode_object)
