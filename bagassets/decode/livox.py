"""`CustomMsg` of livox_ros_driver and livox_ros_driver2: a cloud as a list of points, each with its time.

Points are in metres in the frame of the lidar, or of the vehicle if the driver was given an extrinsic. The header has the time of
the first point, and `offset_time` counts nanoseconds from it (`lddc.cpp` and `CustomPoint.msg` of both drivers, 2.6.0 and 1.2.6).
"""

import numpy as np

from bagassets.base.errors import DecodeError
from bagassets.decode.fields import head
from bagassets.decode.model import CloudReading
from bagassets.decode.point_times import Moment, time_of
from bagassets.recordings.model import Message


def decode_livox(
    message: Message, header_stamp_is: Moment | None = None, _stamp_is: Moment = "end"
) -> CloudReading:
    """Return the points of a cloud with their times, reflectivity as intensity and line as ring.

    Args:
        message: a `CustomMsg`.
        header_stamp_is: the moment of the cloud that the header stamp means, according to the recipe; None: its first point.

    Raises:
        DecodeError: it has another number of points than it says, or points without the fields of a `CustomPoint`.
    """
    stamp, frame_id = head(message)
    if len(message.points) != int(message.point_num):
        raise DecodeError("it has another number of points than point_num says")
    if not message.points:
        return CloudReading(stamp, frame_id, np.empty((0, 5), np.float32), None)
    try:
        rows = [(p.offset_time, p.x, p.y, p.z, p.reflectivity, p.line) for p in message.points]
    except AttributeError as err:
        raise DecodeError(f"its points have no field {err.name}") from None
    table = np.array(rows, np.float64)
    points = table[:, 1:].astype(np.float32)
    finite = np.isfinite(points[:, :3]).all(axis=1)
    offsets_ns = table[:, 0].astype(np.int64)
    if header_stamp_is is not None:
        offsets_ns -= time_of(header_stamp_is, int(offsets_ns.min()), int(offsets_ns.max()))
    times_ns = stamp + offsets_ns
    return CloudReading(
        stamp_ns=stamp,
        frame_id=frame_id,
        points=points[finite],
        times_ns=times_ns[finite],
        dropped=len(points) - int(finite.sum()),
        span_ns=(int(times_ns.min()), int(times_ns.max())),
    )
