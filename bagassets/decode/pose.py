"""`geometry_msgs/PoseStamped` and `PoseWithCovarianceStamped`: the pose of a frame they do not name."""

from bagassets.decode.fields import rigid_transform, stamp_and_frame
from bagassets.decode.model import PoseReading
from bagassets.recordings.model import Message

__all__ = ["decode_pose"]


def decode_pose(message: Message) -> PoseReading:
    """Return the pose of either message; `child` is empty, the recipe says whose pose it is.

    Raises:
        DecodeError: the pose is not finite, or its quaternion is not of unit length.
    """
    stamp_ns, parent = stamp_and_frame(message.header)
    pose = message.pose.pose if hasattr(message.pose, "covariance") else message.pose
    return PoseReading(stamp_ns, parent, "", rigid_transform(pose.position, pose.orientation))
