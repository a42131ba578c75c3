"""`sensor_msgs/Imu`: orientation in a world frame with x east, y north, z up (REP 103, REP 145)."""

from dataclasses import dataclass

from bagassets.base.errors import DecodeError
from bagassets.decode.fields import stamp_and_frame, unit_quaternion
from bagassets.recordings.model import Message

__all__ = ["ImuReading", "decode_imu"]


@dataclass(frozen=True, slots=True)
class ImuReading:
    """The orientation an IMU reports.

    Attributes:
        stamp_ns: header stamp.
        frame_id: frame of the IMU, without leading slash.
        enu_Q_imu: unit quaternion w, x, y, z that turns vectors from the IMU into east, north, up.
    """

    stamp_ns: int
    frame_id: str
    enu_Q_imu: tuple[float, float, float, float]


def decode_imu(message: Message) -> ImuReading:
    """Return the orientation.

    Raises:
        DecodeError: the message carries none (covariance -1), or its quaternion is nonsense.
    """
    stamp_ns, frame_id = stamp_and_frame(message.header)
    if float(message.orientation_covariance[0]) == -1.0:
        raise DecodeError("it carries no orientation (covariance -1)")
    return ImuReading(stamp_ns, frame_id, unit_quaternion(message.orientation))
