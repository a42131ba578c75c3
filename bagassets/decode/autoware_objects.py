"""Autoware's `DetectedObjects` and `TrackedObjects`."""

from operator import attrgetter

from bagassets.base.errors import DecodeError
from bagassets.decode.boxes import NO_EXTENT, BoxDecoder, box_around
from bagassets.decode.fields import rigid_transform, stamp_and_frame
from bagassets.decode.model import BoxReading
from bagassets.geometry.se3 import SE3
from bagassets.recordings.model import Message

__all__ = ["OBJECTS", "decode_object"]

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
BOUNDING_BOX, CYLINDER, POLYGON = 0, 1, 2  # autoware_perception_msgs/Shape


def decode_object(message: Message, item: Message) -> BoxReading:
    """Return the box of an object with its most probable class; detected objects have no track.

    Raises:
        DecodeError: the shape has no extent, no class is named, or the pose is not usable.
    """
    if not len(item.classification):
        raise DecodeError("its object names no class")
    stamp_ns, frame_id = stamp_and_frame(message.header)
    label = int(max(item.classification, key=lambda entry: float(entry.probability)).label)
    pose = item.kinematics.pose_with_covariance.pose
    frame_SE3_box, size_m = _box(rigid_transform(pose.position, pose.orientation), item.shape)
    identifier = getattr(item, "object_id", None)
    return BoxReading(
        stamp_ns=stamp_ns,
        frame_id=frame_id,
        frame_SE3_box=frame_SE3_box,
        size_m=size_m,
        track_id="" if identifier is None else bytes(int(byte) for byte in identifier.uuid).hex(),
        category=CLASSES[label] if label < len(CLASSES) else f"class_{label}",
        score=float(item.existence_probability),
    )


def _box(frame_SE3_object: SE3, shape: Message) -> tuple[SE3, tuple[float, float, float]]:
    """Return `frame_SE3_box`, and width, length, height in metres."""
    length_m, width_m, height_m = (float(getattr(shape.dimensions, axis)) for axis in "xyz")
    if shape.type == BOUNDING_BOX:
        return frame_SE3_object, (width_m, length_m, height_m)
    if shape.type == CYLINDER:  # x is the diameter; y is not used by every version of the message
        return frame_SE3_object, (length_m, length_m, height_m)
    if shape.type == POLYGON:
        return box_around(frame_SE3_object, shape.footprint, height_m)
    raise DecodeError(NO_EXTENT)


OBJECTS = BoxDecoder(attrgetter("objects"), decode_object)
