"""Which decoder reads which type of lidar message that holds points already."""

from collections.abc import Callable
from dataclasses import fields, is_dataclass
from typing import Any

from bagassets.decode.laserscan import decode_laserscan
from bagassets.decode.model import CloudReading
from bagassets.decode.point_times import Moment
from bagassets.decode.pointcloud2 import decode_pointcloud2
from bagassets.errors import DecodeError

__all__ = ["CLOUD_DECODERS", "CloudDecoder", "check_points"]

# A message, what its header stamp means as far as the recipe says, and which moment will be the stamp.
CloudDecoder = Callable[[Any, Moment | None, Moment], CloudReading]

# Messages of any other type on a lidar's topic are searched for Velodyne packets.
CLOUD_DECODERS: dict[str, CloudDecoder] = {
    "sensor_msgs/msg/LaserScan": decode_laserscan,
    "sensor_msgs/msg/PointCloud2": decode_pointcloud2,
}


def check_points(message: Any, most_points: int) -> None:
    """Check how many points a lidar or radar message announces, itself or in a cloud that it holds.

    A point takes several times its recorded size once it is decoded.

    Raises:
        DecodeError: there are more than `most_points`.
    """
    held = [getattr(message, field.name) for field in fields(message)] if is_dataclass(message) else []
    for cloud in (message, *held):
        if hasattr(cloud, "point_step"):
            points = int(cloud.width) * int(cloud.height)
        else:
            points = len(getattr(cloud, "ranges", ()))
        if points > most_points:
            raise DecodeError("it has more points than limits.cloud_points in the recipe allows")
