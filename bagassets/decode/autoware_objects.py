"""Autoware's `DetectedObjects` and `TrackedObjects`."""

from collections.abc import Sequence

from bagassets.decode.boxes import BoxDecoder
from bagassets.decode.fields import rigid_transform, stamp_and_frame
from bagassets.decode.model import BoxReading
from bagassets.errors import DecodeError
from bagassets.recordings.model import Message

__all__ = ["OBJECTS", "decode_object", "items"]

# autoware_perception_msgs/ObjectClassification; the last four came later.
CLASSES = (
    "unknown",
    "car",
    "truck",
    "bus",
    "trailer",
    "motorcycle",
    "bicycle",
    "pedestrian",
    "animal",
    "hazard",
    "over_drivable",
    "under_drivable",
)
BOUNDING_BOX = 0  # autoware_perception_msgs/Shape


def items(message: Message) -> Sequence[Message]:
    """Return the objects of a `DetectedObjects` or `TrackedObjects`."""
    objects: Sequence[Message] = message.objects
    return objects


def decode_object(message: Message, item: Message) -> BoxReading:
    """Return the box of an object with its most probable class; detected objects have no track.

    Raises:
        DecodeError: the shape is no box, no class is named, or the pose is not usable.
    """
    if item.shape.type != BOUNDING_BOX:
        raise DecodeError("its object has no box as shape")
    if not len(item.classification):
        raise DecodeError("its object names no class")
    stamp_ns, frame_id = stamp_and_frame(message.header)
    label = int(max(item.classification, key=lambda entry: float(entry.probability)).label)
    pose = item.kinematics.pose_with_covariance.pose
    size = item.shape.dimensions
    return BoxReading(
        stamp_ns=stamp_ns,
        frame_id=frame_id,
        frame_SE3_box=rigid_transform(pose.position, pose.orientation),
        size_m=(float(size.y), float(size.x), float(size.z)),
        track_id=_uuid(getattr(item, "object_id", None)),
        category=CLASSES[label] if label < len(CLASSES) else f"class_{label}",
        score=float(item.existence_probability),
    )


def _uuid(identifier: Message | None) -> str:
    return "" if identifier is None else bytes(int(byte) for byte in identifier.uuid).hex()


OBJECTS = BoxDecoder(items, decode_object)
