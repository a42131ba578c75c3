"""`nav_msgs/Odometry`: the pose of a child frame."""

from bagassets.decode.fields import rigid_transform, stamp_and_frame
from bagassets.decode.model import PoseReading
from bagassets.geometry.tf_tree import normalise_frame
from bagassets.recordings.model import Message

__all__ = ["decode_odometry"]


def decode_odometry(message: Message) -> PoseReading:
    """Return the pose of an Odometry message; `child` is empty if the message names none.

    Raises:
        DecodeError: the pose is not finite, or its quaternion is not of unit length.
    """
    stamp_ns, parent = stamp_and_frame(message.header)
    pose = message.pose.pose
    child = normalise_frame(message.child_frame_id)
    return PoseReading(stamp_ns, parent, child, rigid_transform(pose.position, pose.orientation))
