"""The table of decoders: which one reads which message type, built in or from a plug-in.

A decoder reads one message type, and its *family* says what it returns. Built-in decoders are lines of `BUILT_IN`, plug-ins
are entry points of installed packages. Neither are imported here, so that planning runs no foreign code and commands start
fast; `bagassets.decode.loading` imports a decoder for its first message. All code that has to know message types (of
topics, in errors, for proposals, for the inventory) asks this table.

Lidars and radars have message types of many drivers, which are recognized by their fields. A decoder that goes by fields
reads any type; a decoder for exactly that type comes first.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

from bagassets.base.errors import PluginError
from bagassets.base.plugins import DecoderPlugin, Family, installed_decoders

AnyFamily = Family | Literal["video", "packets", "ouster", "fix", "imu", "camera_info", "transforms"]
"""The kinds of results of decoders; packages may add decoders to the families in `bagassets.base.plugins.Family`."""

Bulk = Literal["no", "large", "yes"]
ANY = "*"


@dataclass(frozen=True, slots=True)
class Decoder:
    """A line of the table.

    Attributes:
        family: what kind of result it returns.
        msgtype: the message type, `pkg/msg/Type`; `*` for any type with the right fields.
        reference: its place, `module:object`.
        by_fields: it goes by the fields of a message, so a plug-in for the type comes first.
        bulk: whether such messages are bulk data that the inventory does not keep: always, or if they are large for a
            network packet. Changing this changes inventories, so raise their version.
        plugin: the plug-in; None if it is built in.
    """

    family: AnyFamily
    msgtype: str
    reference: str
    by_fields: bool = False
    bulk: Bulk = "no"
    plugin: DecoderPlugin | None = None

    @property
    def key(self) -> dict[str, str] | None:
        """Part of the key of actions that use the decoder; None for built-in ones, which belong to the step's version."""
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
    _line("image", "foxglove_msgs/RawImage", "image:decode_image", bulk="yes"),
    _line("image", "foxglove_msgs/CompressedImage", "compressed_image:decode_compressed_image", bulk="yes"),
    _line("video", "foxglove_msgs/CompressedVideo", "video:decode_video_packet", bulk="yes"),
    _line("video", "ffmpeg_image_transport_msgs/FFMPEGPacket", "video:decode_video_packet"),
    # Isaac's encoders publish video as these, with the name of the codec as `format`.
    _line("video", "sensor_msgs/CompressedImage", "video:decode_video_packet", by_fields=True, bulk="yes"),
    _line("cloud", "sensor_msgs/PointCloud2", "pointcloud2:decode_pointcloud2", bulk="yes"),
    _line("cloud", "sensor_msgs/PointCloud", "pointcloud2:decode_pointcloud2", bulk="yes"),
    _line("cloud", "sensor_msgs/LaserScan", "laserscan:decode_laserscan", bulk="yes"),
    _line("cloud", "sensor_msgs/MultiEchoLaserScan", "laserscan:decode_laserscan"),
    _line("cloud", "point_cloud_interfaces/CompressedPointCloud2", "pointcloud2:decode_pointcloud2"),
    _line("cloud", "foxglove_msgs/PointCloud", "pointcloud2:decode_pointcloud2", bulk="yes"),
    _line("cloud", "foxglove_msgs/LaserScan", "laserscan:decode_laserscan", bulk="yes"),
    _line("cloud", "livox_ros_driver2/CustomMsg", "livox:decode_livox"),
    _line("cloud", "livox_ros_driver/CustomMsg", "livox:decode_livox"),
    _line("ouster", "ouster_sensor_msgs/PacketMsg", "ouster:packet_in"),
    _line("ouster", "ouster_ros/PacketMsg", "ouster:packet_in"),
    _line("ouster", "ouster_msgs/PacketMsg", "ouster:packet_in"),
    _line("packets", "velodyne_msgs/VelodyneScan", "packets:packets_in", by_fields=True, bulk="yes"),
    _line("packets", "ethernet_msgs/Packet", "packets:packets_in", by_fields=True, bulk="large"),
    _line("packets", "udp_msgs/UdpPacket", "packets:packets_in", by_fields=True, bulk="large"),
    _line("packets", "std_msgs/ByteMultiArray", "packets:packets_in", by_fields=True),
    _line("packets", "std_msgs/UInt8MultiArray", "packets:packets_in", by_fields=True),
    _line("packets", ANY, "packets:packets_in"),
    _line("radar", "sensor_msgs/PointCloud2", "radar:decode_radar", bulk="yes"),
    _line("radar", "point_cloud_interfaces/CompressedPointCloud2", "radar:decode_radar"),
    _line("radar", "foxglove_msgs/PointCloud", "radar:decode_radar", bulk="yes"),
    _line("radar", "sensor_msgs/PointCloud", "radar:decode_radar", by_fields=True, bulk="yes"),
    _line("radar", ANY, "radar:decode_radar"),
    _line("pose", "nav_msgs/Odometry", "poses:decode_pose"),
    _line("pose", "geometry_msgs/PoseStamped", "poses:decode_pose"),
    _line("pose", "geometry_msgs/PoseWithCovarianceStamped", "poses:decode_pose"),
    _line("pose", "geometry_msgs/TransformStamped", "poses:decode_transform"),
    _line("pose", "foxglove_msgs/PoseInFrame", "poses:decode_pose"),
    _line("pose", "foxglove_msgs/Odometry", "poses:decode_pose"),
    _line("fix", "sensor_msgs/NavSatFix", "poses:decode_navsat"),
    _line("fix", "foxglove_msgs/LocationFix", "poses:decode_navsat"),
    _line("imu", "sensor_msgs/Imu", "poses:decode_imu"),
    _line("camera_info", "sensor_msgs/CameraInfo", "camera_info:decode_camera_info"),
    _line("camera_info", "foxglove_msgs/CameraCalibration", "camera_info:decode_camera_info"),
    _line("transforms", "tf2_msgs/TFMessage", "poses:transforms"),
    _line("transforms", "tf/tfMessage", "poses:transforms"),
    _line("transforms", "foxglove_msgs/FrameTransforms", "poses:transforms"),
    _line("transforms", "foxglove_msgs/FrameTransform", "poses:one_transform"),
    _line("boxes", "vision_msgs/Detection3DArray", "box_messages:DETECTIONS"),
    _line("boxes", "visualization_msgs/Marker", "box_messages:MARKER"),
    _line("boxes", "visualization_msgs/MarkerArray", "box_messages:MARKERS"),
    _line("boxes", "derived_object_msgs/ObjectArray", "box_messages:DERIVED_OBJECTS"),
    _line("boxes", "jsk_recognition_msgs/BoundingBoxArray", "box_messages:BOUNDING_BOXES"),
    _line("boxes", "autoware_perception_msgs/DetectedObjects", "box_messages:AUTOWARE_OBJECTS"),
    _line("boxes", "autoware_perception_msgs/TrackedObjects", "box_messages:AUTOWARE_OBJECTS"),
    _line("boxes", "autoware_auto_perception_msgs/DetectedObjects", "box_messages:AUTOWARE_OBJECTS"),
    _line("boxes", "autoware_auto_perception_msgs/TrackedObjects", "box_messages:AUTOWARE_OBJECTS"),
    _line("boxes", "foxglove_msgs/SceneUpdate", "box_messages:SCENE_UPDATE"),
)
_TABLE: Mapping[tuple[str, str], Decoder] = {(line.family, line.msgtype): line for line in BUILT_IN}

# Packages of standard types, none of a driver: decoders that go by fields do not read them unless the table says so.
_COMMON_PACKAGES = frozenset(
    [
        "actionlib_msgs",
        "builtin_interfaces",
        "diagnostic_msgs",
        "foxglove_msgs",
        "nav_msgs",
        "rcl_interfaces",
        "rosgraph_msgs",
        "sensor_msgs",
        "std_msgs",
        "tf",
        "tf2_msgs",
    ]
)
# Messages of another family for the same channels, or recognized by their fields, as errors call them.
_FOUND_BY_FIELDS: Mapping[AnyFamily, str] = {
    "image": "video (foxglove_msgs/CompressedVideo, ffmpeg_image_transport_msgs/FFMPEGPacket)",
    "cloud": "Velodyne or Hesai packets (velodyne_msgs/VelodyneScan, pandar_msgs/PandarScan, ethernet_msgs/Packet and the like) or "
    "Ouster packets (ouster_sensor_msgs/PacketMsg)",
    "radar": "the targets of a radar (radar_msgs/RadarScan, RadarTracks and the like)",
}


def find_decoder(family: AnyFamily, msgtype: str) -> Decoder | None:
    """Return the decoder of a type, or None if there is none.

    Raises:
        PluginError: several plug-ins claim the type, or one claims a type of a built-in decoder.
    """
    own = built_in_decoder(family, msgtype)
    plugins = [
        plugin
        for plugin in installed_decoders().plugins
        if (plugin.family, plugin.msgtype) == (family, msgtype)
    ]
    if not plugins:
        return own
    claims = " and ".join(f"{plugin.distribution}" for plugin in plugins)
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
    """Return the decoder's part of the key of actions; None without a plug-in.

    Raises:
        PluginError: as `find_decoder`.
    """
    decoder = find_decoder(family, msgtype)
    return None if decoder is None else decoder.key


def own_types(family: AnyFamily) -> tuple[str, ...]:
    """Return the types of a family in the table, without those of plug-ins."""
    return tuple(line.msgtype for line in BUILT_IN if line.family == family and line.msgtype != ANY)


def types_of(family: AnyFamily) -> tuple[str, ...]:
    """Return the types of a family, those of plug-ins last."""
    plugins = (plugin.msgtype for plugin in installed_decoders().plugins if plugin.family == family)
    return tuple(dict.fromkeys((*own_types(family), *plugins)))


def families_of(msgtype: str) -> tuple[AnyFamily, ...]:
    """Return the families with a decoder for a type, plug-ins first; decoders that go by fields do not count."""
    plugins = (plugin.family for plugin in installed_decoders().plugins if plugin.msgtype == msgtype)
    own = (line.family for line in BUILT_IN if line.msgtype == msgtype and not line.by_fields)
    return tuple(dict.fromkeys((*plugins, *own)))


def bulk_types(bulk: Bulk) -> frozenset[str]:
    """Return the types of bulk data; plug-ins do not count, because inventories do not depend on them."""
    return frozenset(line.msgtype for line in BUILT_IN if line.bulk == bulk)


def expected_types(family: AnyFamily) -> str:
    """Return the types that a topic of a family may have, for errors about other types."""
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
    """Return the end of a sentence: what to do about a type without a decoder."""
    package, _, kind = msgtype.partition("/msg/")
    text = f"correct the topic in the recipe, or install a decoder plug-in ({family}.{package}.{kind})"
    unusable = installed_decoders().unusable
    return f"{text}. {' '.join(unusable)}" if unusable else f"{text}."
