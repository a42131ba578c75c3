"""Which decoder reads which messages: one table, in which built-in decoders stand beside those of plug-ins.

A decoder belongs to a *family*, which says what it makes of a message, and reads one type. A built-in one is
a line of `BUILT_IN`, a plug-in an entry point of an installed package. Neither is imported here, so that
planning runs no foreign code and commands start fast; `bagassets.decode.loading` imports a decoder when its
first message comes. Whatever has to know message types (what a topic may carry, errors, proposals, what the
inventory keeps) asks this table.

What lidars and radars send comes in the types of many drivers and is found by its fields. Such a decoder reads
any type; one of just that type goes first.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

from bagassets.errors import PluginError
from bagassets.plugins import DecoderPlugin, Family, installed_decoders

__all__ = [
    "BUILT_IN",
    "AnyFamily",
    "Decoder",
    "advice",
    "built_in_decoder",
    "bulk_types",
    "decoder_key",
    "expected_types",
    "families_of",
    "find_decoder",
    "own_types",
    "types_of",
]

AnyFamily = Family | Literal["packets", "fix", "imu", "camera_info", "transforms"]
"""What a decoder makes of messages; packages may add decoders to those of `bagassets.plugins.Family`."""

Bulk = Literal["no", "large", "yes"]
ANY = "*"


@dataclass(frozen=True, slots=True)
class Decoder:
    """A line of the table.

    Attributes:
        family: what the decoder makes of a message.
        msgtype: the type it reads, `pkg/msg/Type`; `*` for any whose fields are what it looks for.
        reference: where it is, `module:object`.
        by_fields: it goes by the fields of a message, so that a plug-in for the type goes first.
        bulk: whether such messages are sensor data in bulk, which the inventory does not keep: always, or if they
            are large for a network packet. A line that says so changes inventories, whose version must be raised.
        plugin: the plug-in that it is; None if it is built in.
    """

    family: AnyFamily
    msgtype: str
    reference: str
    by_fields: bool = False
    bulk: Bulk = "no"
    plugin: DecoderPlugin | None = None

    @property
    def key(self) -> dict[str, str] | None:
        """What an action that uses the decoder is keyed by; None of built-in ones, which belong to the step's version."""
        return None if self.plugin is None else self.plugin.as_json()


def _line(
    family: AnyFamily, msgtype: str, reference: str, *, by_fields: bool = False, bulk: Bulk = "no"
) -> Decoder:
    return Decoder(
        family,
        msgtype.replace("/", "/msg/"),
        f"bagassets.decode.{reference}",
        by_fields or msgtype == ANY,
        bulk,
    )


# In the order in which errors list the types of a family.
BUILT_IN = (
    _line("image", "sensor_msgs/Image", "image:decode_image", bulk="yes"),
    _line("image", "sensor_msgs/CompressedImage", "compressed_image:decode_compressed_image", bulk="yes"),
    _line("cloud", "sensor_msgs/PointCloud2", "pointcloud2:decode_pointcloud2", bulk="yes"),
    _line("cloud", "sensor_msgs/LaserScan", "laserscan:decode_laserscan", bulk="yes"),
    _line("packets", "velodyne_msgs/VelodyneScan", "packets:packets_in", by_fields=True, bulk="yes"),
    _line("packets", "ethernet_msgs/Packet", "packets:packets_in", by_fields=True, bulk="large"),
    _line("packets", "udp_msgs/UdpPacket", "packets:packets_in", by_fields=True, bulk="large"),
    _line("packets", "std_msgs/ByteMultiArray", "packets:packets_in", by_fields=True),
    _line("packets", "std_msgs/UInt8MultiArray", "packets:packets_in", by_fields=True),
    _line("packets", ANY, "packets:packets_in"),
    _line("radar", "sensor_msgs/PointCloud2", "radar:decode_radar", bulk="yes"),
    _line("radar", "sensor_msgs/PointCloud", "radar:decode_radar", by_fields=True, bulk="yes"),
    _line("radar", ANY, "radar:decode_radar"),
    _line("pose", "nav_msgs/Odometry", "odometry:decode_odometry"),
    _line("pose", "geometry_msgs/PoseStamped", "pose:decode_pose"),
    _line("pose", "geometry_msgs/PoseWithCovarianceStamped", "pose:decode_pose"),
    _line("fix", "sensor_msgs/NavSatFix", "navsat:decode_navsat"),
    _line("imu", "sensor_msgs/Imu", "imu:decode_imu"),
    _line("camera_info", "sensor_msgs/CameraInfo", "camera_info:decode_camera_info"),
    _line("transforms", "tf2_msgs/TFMessage", "tf:transforms"),
    _line("transforms", "tf/tfMessage", "tf:transforms"),
    _line("boxes", "vision_msgs/Detection3DArray", "detection3d:DETECTIONS"),
    _line("boxes", "visualization_msgs/Marker", "markers:MARKER"),
    _line("boxes", "visualization_msgs/MarkerArray", "markers:MARKERS"),
    _line("boxes", "derived_object_msgs/ObjectArray", "object_array:OBJECTS"),
    _line("boxes", "jsk_recognition_msgs/BoundingBoxArray", "bounding_boxes:BOXES"),
    _line("boxes", "autoware_perception_msgs/DetectedObjects", "autoware_objects:OBJECTS"),
    _line("boxes", "autoware_perception_msgs/TrackedObjects", "autoware_objects:OBJECTS"),
    _line("boxes", "autoware_auto_perception_msgs/DetectedObjects", "autoware_objects:OBJECTS"),
    _line("boxes", "autoware_auto_perception_msgs/TrackedObjects", "autoware_objects:OBJECTS"),
)
_TABLE: Mapping[tuple[str, str], Decoder] = {(line.family, line.msgtype): line for line in BUILT_IN}

# Packages whose types are the same everywhere, none of them a driver's: not searched unless the table says so.
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
# What is found by its fields, as errors call it.
_FOUND_BY_FIELDS: Mapping[AnyFamily, str] = {
    "cloud": "Velodyne packets (velodyne_msgs/VelodyneScan, ethernet_msgs/Packet and the like)",
    "radar": "the targets of a radar (radar_msgs/RadarScan, RadarTracks and the like)",
}


def find_decoder(family: AnyFamily, msgtype: str) -> Decoder | None:
    """Return the decoder of a type, or None if there is none.

    Raises:
        PluginError: several plug-ins claim the type, or one that is decoded without a plug-in.
    """
    own = built_in_decoder(family, msgtype)
    plugins = [
        plugin
        for plugin in installed_decoders().plugins
        if (plugin.family, plugin.msgtype) == (family, msgtype)
    ]
    if not plugins:
        return own
    claims = " and ".join(f"{plugin.distribution} {plugin.version}" for plugin in plugins)
    if own is not None and not own.by_fields:
        raise PluginError(
            f"{msgtype}: {claims} would replace the decoder that bagassets has for it; uninstall it, "
            "or let it decode a type of its own."
        )
    if len(plugins) > 1:
        raise PluginError(
            f"{msgtype}: decoders from {claims} claim it ({plugins[0].name}); uninstall all but one."
        )
    return Decoder(family, msgtype, plugins[0].reference, plugin=plugins[0])


def built_in_decoder(family: AnyFamily, msgtype: str) -> Decoder | None:
    """Return the built-in decoder of a type, or None if there is none."""
    line = _TABLE.get((family, msgtype))
    if line is None and msgtype.partition("/")[0] not in _COMMON_PACKAGES:
        line = _TABLE.get((family, ANY))
    return line if line is None else replace(line, msgtype=msgtype)


def decoder_key(family: AnyFamily, msgtype: str) -> dict[str, str] | None:
    """Return what an action whose messages a plug-in decodes is keyed by; None where none does.

    Raises:
        PluginError: as `find_decoder`.
    """
    decoder = find_decoder(family, msgtype)
    return None if decoder is None else decoder.key


def own_types(family: AnyFamily) -> tuple[str, ...]:
    """Return the types of a family that need no plug-in, as far as the table names them."""
    return tuple(line.msgtype for line in BUILT_IN if line.family == family and line.msgtype != ANY)


def types_of(family: AnyFamily) -> tuple[str, ...]:
    """Return the types of a family, those of plug-ins last."""
    plugins = (plugin.msgtype for plugin in installed_decoders().plugins if plugin.family == family)
    return tuple(dict.fromkeys((*own_types(family), *plugins)))


def families_of(msgtype: str) -> tuple[AnyFamily, ...]:
    """Return what decoders of a type make of it, plug-ins first; decoders that go by its fields do not count."""
    plugins = (plugin.family for plugin in installed_decoders().plugins if plugin.msgtype == msgtype)
    own = (line.family for line in BUILT_IN if line.msgtype == msgtype and not line.by_fields)
    return tuple(dict.fromkeys((*plugins, *own)))


def bulk_types(bulk: Bulk) -> frozenset[str]:
    """Return the types whose messages are sensor data in bulk; plug-ins do not count, on which no inventory depends."""
    return frozenset(line.msgtype for line in BUILT_IN if line.bulk == bulk)


def expected_types(family: AnyFamily) -> str:
    """Return what a topic of a family carries, for an error about one that carries something else."""
    exact = (line for line in BUILT_IN if line.family == family and not line.by_fields)
    names = [line.msgtype.replace("/msg/", "/") for line in exact]
    packages = [name.partition("/")[0] for name in names]
    shown = [
        name.rpartition("/")[2] if number and packages[number] == packages[number - 1] else name
        for number, name in enumerate(names)
    ]
    by_fields = _FOUND_BY_FIELDS.get(family)
    if by_fields is None:
        return " or ".join(filter(None, (", ".join(shown[:-1]), shown[-1])))
    return f"{', '.join(shown)}{',' if len(shown) > 1 else ''} or {by_fields}"


def advice(family: Family, msgtype: str) -> str:
    """Return what to do about a type that nothing decodes, to end a sentence with."""
    package, _, kind = msgtype.partition("/msg/")
    text = f"correct the topic in the recipe, or install a decoder plug-in ({family}.{package}.{kind})"
    unusable = installed_decoders().unusable
    return f"{text}. {' '.join(unusable)}" if unusable else f"{text}."
