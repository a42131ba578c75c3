"""Which types of messages a channel can be made of, told before a message of its topic is read.

Images and clouds are told by their type. Lidar packets and radar targets come in types of many
drivers and are told by their fields, so that here only types are refused which everybody knows
to hold something else.
"""

from typing import Any, Literal

from bagassets.decode.registry import decoder_params
from bagassets.errors import DecodeError
from bagassets.plugins import BUILT_IN, installed_decoders

__all__ = ["require_type"]

_Family = Literal["image", "cloud", "radar"]

_EXPECTED: dict[_Family, str] = {
    "image": "sensor_msgs/Image or CompressedImage",
    "cloud": "sensor_msgs/PointCloud2, LaserScan, or Velodyne packets (velodyne_msgs/VelodyneScan, "
    "ethernet_msgs/Packet and the like)",
    "radar": "sensor_msgs/PointCloud2 or the targets of a radar (radar_msgs/RadarScan, RadarTracks and the like)",
}
# Packages whose types are the same everywhere, none of them a driver's.
_COMMON_PACKAGES = frozenset(
    [
        "actionlib_msgs",
        "builtin_interfaces",
        "diagnostic_msgs",
        "nav_msgs",
        "rcl_interfaces",
        "rosgraph_msgs",
        "sensor_msgs",
        "std_msgs",
        "tf",
        "tf2_msgs",
    ]
)
# Types of these packages whose fields can hold what is searched for.
_BY_FIELDS: dict[_Family, frozenset[str]] = {
    "image": frozenset(),
    "cloud": frozenset({"std_msgs/msg/ByteMultiArray", "std_msgs/msg/UInt8MultiArray"}),
    "radar": frozenset({"sensor_msgs/msg/PointCloud"}),
}


def require_type(name: str, topic: str, msgtype: str, family: _Family) -> dict[str, Any]:
    """Return the parameter `decoder` of a channel whose messages a plug-in decodes; else nothing.

    Args:
        name: canonical channel.
        topic: where its messages are.
        msgtype: their type, `pkg/msg/Type`.
        family: what the channel is made of.

    Raises:
        DecodeError: messages of this type cannot be that.
        PluginError: several decoder plug-ins claim the type.
    """
    plugin = decoder_params(family, msgtype)
    known = BUILT_IN[family] | _BY_FIELDS[family]
    if plugin or msgtype in known:
        return plugin
    if family == "image" or msgtype.partition("/")[0] in _COMMON_PACKAGES:
        raise DecodeError(
            f"{name} ({topic}): carries {msgtype}, expected {_EXPECTED[family]}; "
            f"{installed_decoders().advice(family, msgtype)}"
        )
    return plugin
