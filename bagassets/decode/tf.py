"""`tf2_msgs/TFMessage` and the older `tf/tfMessage`: several edges of a TF tree."""

from operator import attrgetter

from bagassets.base.errors import DecodeError
from bagassets.decode.fields import rigid_transform, stamp_and_frame
from bagassets.decode.model import PoseReading
from bagassets.geometry.tf_tree import normalise_frame
from bagassets.recordings.model import Message

__all__ = ["decode_transform", "transforms"]


transforms = attrgetter("transforms")
"""Returns the `TransformStamped` messages inside, each to be decoded by itself: one edge that is nonsense must not cost the
others of its message."""


def decode_transform(stamped: Message) -> PoseReading:
    """Return one edge.

    Raises:
        DecodeError: the transform is not finite, its quaternion is not of unit length, or a
            frame is missing or its own parent.
    """
    stamp_ns, parent = stamp_and_frame(stamped.header)
    child = normalise_frame(stamped.child_frame_id)
    if not parent or not child:
        raise DecodeError("it lacks a frame id")
    if parent == child:
        raise DecodeError("its frame is its own parent")
    transform = stamped.transform
    return PoseReading(stamp_ns, parent, child, rigid_transform(transform.translation, transform.rotation))
