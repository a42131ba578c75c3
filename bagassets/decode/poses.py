"""Messages that say where something is: poses, edges of a TF tree, GNSS fixes, and the orientation of an IMU."""

from dataclasses import dataclass
from math import isfinite, nan
from operator import attrgetter

from bagassets.base.errors import DecodeError
from bagassets.decode.fields import head, rigid_transform, stamp_and_frame, unit_quaternion
from bagassets.decode.model import PoseReading
from bagassets.geometry.tf_tree import normalise_frame
from bagassets.recordings.model import Message

_NO_FIX = -1  # sensor_msgs/NavSatStatus STATUS_NO_FIX


def decode_pose(message: Message) -> PoseReading:
    """Return the pose in odometry, or in a stamped pose, of ROS or Foxglove.

    These are `nav_msgs/Odometry`, `geometry_msgs/PoseStamped`, `PoseWithCovarianceStamped`, and Foxglove's `Odometry` and
    `PoseInFrame`. Only odometry names a child frame; where `child` is empty, the recipe says whose pose it is.

    Raises:
        DecodeError: the pose is not finite, or its quaternion is not of unit length.
    """
    stamp_ns, parent = head(message)
    child = normalise_frame(getattr(message, "child_frame_id", "") or getattr(message, "body_frame_id", ""))
    pose = message.pose.pose if hasattr(message.pose, "covariance") else message.pose
    return PoseReading(stamp_ns, parent, child, rigid_transform(pose.position, pose.orientation))


transforms = attrgetter("transforms")
"""Returns the `TransformStamped` messages in `tf2_msgs/TFMessage` or the older `tf/tfMessage`, or those in `foxglove.FrameTransforms`, each to be decoded by itself:
one edge that is nonsense must not cost the others of its message."""


def one_transform(message: Message) -> tuple[Message]:
    """Return what is in a `foxglove.FrameTransform`: itself."""
    return (message,)


def decode_transform(stamped: Message) -> PoseReading:
    """Return one edge of a TF tree, a `geometry_msgs/TransformStamped` or a `foxglove.FrameTransform`.

    Raises:
        DecodeError: the transform is not finite, its quaternion is not of unit length, or a
            frame is missing or its own parent.
    """
    stamp_ns, parent = head(stamped)
    child = normalise_frame(stamped.child_frame_id)
    if not parent or not child:
        raise DecodeError("it lacks a frame id")
    if parent == child:
        raise DecodeError("its frame is its own parent")
    transform = getattr(stamped, "transform", stamped)
    return PoseReading(stamp_ns, parent, child, rigid_transform(transform.translation, transform.rotation))


@dataclass(frozen=True, slots=True)
class FixReading:
    """One GNSS fix, a position on the WGS84 ellipsoid.

    Attributes:
        stamp_ns: header stamp.
        frame_id: frame of the antenna, without leading slash.
        lat_deg: WGS84 latitude.
        lon_deg: WGS84 longitude.
        alt_m: height above the ellipsoid; NaN if the receiver gives none.
    """

    stamp_ns: int
    frame_id: str
    lat_deg: float
    lon_deg: float
    alt_m: float


def decode_navsat(message: Message) -> FixReading:
    """Return the fix in a `sensor_msgs/NavSatFix`, or a `foxglove.LocationFix`, which is there only if the receiver has one.

    Raises:
        DecodeError: the receiver has no fix, or the coordinates are not on Earth.
    """
    stamp_ns, frame_id = head(message)
    lat, lon, alt = float(message.latitude), float(message.longitude), float(message.altitude)
    if hasattr(message, "status") and int(message.status.status) <= _NO_FIX:
        raise DecodeError("the receiver has no fix (status -1)")
    if not (isfinite(lat) and isfinite(lon)):
        raise DecodeError("its latitude or longitude is not finite")
    if abs(lat) > 90.0 or abs(lon) > 360.0:
        raise DecodeError("its latitude or longitude is out of range")
    if lat == 0.0 and lon == 0.0:
        raise DecodeError("it is at 0, 0, which receivers send before they know better")
    return FixReading(stamp_ns, frame_id, lat, lon, alt if isfinite(alt) else nan)


@dataclass(frozen=True, slots=True)
class ImuReading:
    """The orientation an IMU reports, in a world frame with x east, y north, z up (REP 103, REP 145).

    Attributes:
        stamp_ns: header stamp.
        frame_id: frame of the IMU, without leading slash.
        enu_Q_imu: unit quaternion w, x, y, z that turns vectors from the IMU into east, north, up.
    """

    stamp_ns: int
    frame_id: str
    enu_Q_imu: tuple[float, float, float, float]


def decode_imu(message: Message) -> ImuReading:
    """Return the orientation in a `sensor_msgs/Imu`.

    Raises:
        DecodeError: the message carries none (covariance -1), or its quaternion is nonsense.
    """
    stamp_ns, frame_id = stamp_and_frame(message.header)
    if float(message.orientation_covariance[0]) == -1.0:
        raise DecodeError("it carries no orientation (covariance -1)")
    return ImuReading(stamp_ns, frame_id, unit_quaternion(message.orientation))
