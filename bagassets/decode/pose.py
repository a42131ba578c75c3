"""Poses: `nav_msgs/Odometry` of a child frame, `geometry_msgs/PoseStamped` and `PoseWithCovarianceStamped` of one they do not name."""

from bagassets.decode.fields import rigid_transform, stamp_and_frame
from bagassets.decode.model import PoseReading
from bagassets.geometry.tf_tree import normalise_frame
from bagassets.recordings.model import Message

__all__ = ["decode_pose"]


def decode_pose(message: Message) -> PoseReading:
    """Return the pose of any of these messages; where `child` is empty, the recipe says whose pose it is.

    Raises:
        DecodeError: the pose is not finite, or its quaternion is not of unit length.
    """
    stamp_ns, parent = stamp_and_frame(message.header)
    child = normalise_frame(getattr(message, "child_frame_id", ""))
    pose = message.pose.pose if hasattr(message.pose, "covariance") else message.pose
    return PoseReading(stamp_ns, parent, child, rigid_transform(pose.position, pose.orientation))
