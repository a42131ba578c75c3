"""Which decoder reads which type of lidar message that holds points already."""

from collections.abc import Callable
from typing import Any

from bagassets.decode.laserscan import decode_laserscan
from bagassets.decode.model import CloudReading
from bagassets.decode.point_times import Moment
from bagassets.decode.pointcloud2 import decode_pointcloud2

__all__ = ["CLOUD_DECODERS", "CloudDecoder"]

# A message, what its header stamp means as far as the recipe says, and which moment will be the stamp.
CloudDecoder = Callable[[Any, Moment | None, Moment], CloudReading]

# Messages of any other type on a lidar's topic are searched for Velodyne packets.
CLOUD_DECODERS: dict[str, CloudDecoder] = {
    "sensor_msgs/msg/LaserScan": decode_laserscan,
    "sensor_msgs/msg/PointCloud2": decode_pointcloud2,
}
