"""Fields that many messages share: stamps, frame ids, poses, points.

Texts of errors contain no numbers, because steps count lost messages by them.
"""

from dataclasses import fields, is_dataclass
from math import isfinite, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bagassets.base.errors import DecodeError, UnsetError
from bagassets.geometry.se3 import SE3
from bagassets.geometry.tf_tree import normalise_frame
from bagassets.recordings.heads import head_of
from bagassets.recordings.model import Message

Column = NDArray[Any]
"""One field of many points, of whichever type of number the message has it in."""

# Coordinates in metres are relative to the Earth's centre (ECEF), the equator (UTM) or a place nearby; none exceeds
# twice the Earth's circumference.
_FARTHEST_M = 8e7


def stamp_ns(time: Message) -> int:
    """Return a `builtin_interfaces/Time` as nanoseconds since the epoch."""
    return int(time.sec) * 1_000_000_000 + int(time.nanosec)


def stamp_and_frame(header: Message, otherwise: Message | None = None) -> tuple[int, str]:
    """Return stamp in nanoseconds and frame id, without leading slash, of a `std_msgs/Header`.

    Args:
        header: of a message.
        otherwise: the header whose stamp or frame holds where this one leaves it empty.
    """
    time_ns, frame_id = stamp_ns(header.stamp), normalise_frame(header.frame_id)
    if otherwise is None:
        return time_ns, frame_id
    other_ns, other_frame_id = stamp_and_frame(otherwise)
    return time_ns or other_ns, frame_id or other_frame_id


def head(message: Message) -> tuple[int, str]:
    """Return stamp in nanoseconds and frame id, without leading slash, of a message with a header or, as Foxglove's, a timestamp.

    Raises:
        DecodeError: it has neither.
    """
    found = head_of(message)
    if found is None:
        raise DecodeError("it has no header")
    return found[0], normalise_frame(found[1])


def byte_array(data: object) -> NDArray[np.uint8]:
    """Return bytes as (N,) uint8, whether a message has them as an array or, as of protobuf and JSON, as bytes."""
    if isinstance(data, bytes):
        return np.frombuffer(data, np.uint8)
    return np.ascontiguousarray(data).view(np.uint8)


def pose_of(pose: Message) -> SE3:
    """Return a `foxglove.Pose`; one that was not set is the identity.

    Raises:
        DecodeError: see `rigid_transform`.
    """
    try:
        return rigid_transform(pose.position, pose.orientation)
    except UnsetError:
        return SE3()


def unit_quaternion(orientation: Message) -> tuple[float, float, float, float]:
    """Return a `geometry_msgs/Quaternion` as w, x, y, z.

    A length within 10 % of one is normalised, because some publishers use single precision; any other quaternion is invalid,
    most often all zeros.

    Raises:
        UnsetError: all numbers are zero.
        DecodeError: a number is not finite, or the length is far from one.
    """
    w, x, y, z = (float(v) for v in (orientation.w, orientation.x, orientation.y, orientation.z))
    length = sqrt(w * w + x * x + y * y + z * z)
    if not 0.9 < length < 1.1:
        kind = DecodeError if length else UnsetError
        raise kind("its quaternion is not of unit length")
    return (w / length, x / length, y / length, z / length)


def rigid_transform(position: Message, orientation: Message) -> SE3:
    """Return the transform of a `Point` or `Vector3` in metres and a `Quaternion`.

    Raises:
        UnsetError: the quaternion is zero.
        DecodeError: a number is not finite, the position is nowhere on Earth, or the quaternion is not of
            unit length.
    """
    quaternion = unit_quaternion(orientation)
    translation = (float(position.x), float(position.y), float(position.z))
    if not all(isfinite(v) for v in translation):
        raise DecodeError("its position is not finite")
    if not all(abs(v) < _FARTHEST_M for v in translation):
        raise DecodeError("its position is farther away than any place on Earth")
    return SE3(quaternion, translation)


def members(message: Message) -> tuple[str, ...]:
    """Return the names of a message's fields."""
    if not is_dataclass(message):
        return ()
    return tuple(field.name for field in fields(message) if field.name != "__msgtype__")  # of rosbags


def check_points(message: Message, most_points: int) -> None:
    """Check the number of points that a lidar or radar message, or a cloud in it, announces.

    A decoded point takes several times its recorded size.

    Raises:
        DecodeError: there are more than `most_points`.
    """
    for cloud in (message, *(getattr(message, name) for name in members(message))):
        if hasattr(cloud, "point_step"):
            points = int(cloud.width) * int(cloud.height)
        elif hasattr(cloud, "point_num"):
            points = int(cloud.point_num)
        elif hasattr(cloud, "channels"):
            points = len(cloud.points)
        elif hasattr(cloud, "point_stride"):
            points = len(cloud.data) // max(1, int(cloud.point_stride))
        else:
            points = len(getattr(cloud, "ranges", ()))
        if points > most_points:
            raise DecodeError("it has more points than limits.cloud_points in the recipe allows")
