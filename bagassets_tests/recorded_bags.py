"""Small recordings of every format, written by tests from the same messages."""

from dataclasses import dataclass

import numpy as np
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer
from rosbags.typesys import Stores, get_typestore

ROS1 = get_typestore(Stores.ROS1_NOETIC)
ROS2 = get_typestore(Stores.ROS2_HUMBLE)
SECOND = 1_000_000_000
# 2024-06-21 12:00:00 UTC.
NOON_NS = 1_718_971_200 * SECOND


@dataclass
class Message:
    topic: str
    msgtype: str
    log_time_ns: int
    make: object  # type store -> message


def header(store, stamp_ns, frame):
    time = store.types["builtin_interfaces/msg/Time"](stamp_ns // SECOND, stamp_ns % SECOND)
    kind = store.types["std_msgs/msg/Header"]
    return kind(0, time, frame) if store is ROS1 else kind(time, frame)


def point(log_time_ns, stamp_ns=None, frame="map", topic="/point", x=1.0):
    def make(store):
        stamp = log_time_ns if stamp_ns is None else stamp_ns
        position = store.types["geometry_msgs/msg/Point"](x, 2.0, 3.0)
        return store.types["geometry_msgs/msg/PointStamped"](header(store, stamp, frame), position)

    return Message(topic, "geometry_msgs/msg/PointStamped", log_time_ns, make)


def text(log_time_ns, data="hello", topic="/text"):
    return Message(
        topic, "std_msgs/msg/String", log_time_ns, lambda store: store.types["std_msgs/msg/String"](data)
    )


def image(log_time_ns, size=8, topic="/camera"):
    def make(store):
        data = np.zeros(size, np.uint8)
        return store.types["sensor_msgs/msg/CompressedImage"](header(store, log_time_ns, "cam"), "jpeg", data)

    return Message(topic, "sensor_msgs/msg/CompressedImage", log_time_ns, make)


def fix(log_time_ns, lat, lon, alt=500.0, status=0, stamp_ns=None, topic="/fix"):
    def make(store):
        kind = store.types["sensor_msgs/msg/NavSatStatus"]
        stamp = log_time_ns if stamp_ns is None else stamp_ns
        return store.types["sensor_msgs/msg/NavSatFix"](
            header(store, stamp, "gps"), kind(status, 1), lat, lon, alt, np.zeros(9), 0
        )

    return Message(topic, "sensor_msgs/msg/NavSatFix", log_time_ns, make)


def write_ros1(path, messages, compression=None):
    writer = Rosbag1Writer(path)
    if compression is not None:
        writer.set_compression(Rosbag1Writer.CompressionFormat[compression])
    with writer:
        connections = {}
        for m in messages:
            if m.topic not in connections:
                connections[m.topic] = writer.add_connection(m.topic, m.msgtype, typestore=ROS1)
            data = ROS1.serialize_ros1(m.make(ROS1), m.msgtype)
            writer.write(connections[m.topic], m.log_time_ns, data)
    return path


def write_ros2(path, messages, storage="SQLITE3", version=9):
    with Rosbag2Writer(path, version=version, storage_plugin=StoragePlugin[storage]) as writer:
        connections = {}
        for m in messages:
            if m.topic not in connections:
                connections[m.topic] = writer.add_connection(m.topic, m.msgtype, typestore=ROS2)
            writer.write(connections[m.topic], m.log_time_ns, ROS2.serialize_cdr(m.make(ROS2), m.msgtype))
    return path


def write_mcap(path, messages, *, foreign=()):
    """Write a bare MCAP; `foreign` are (topic, log time, encoding, payload) without schema."""
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start()
        channels = {}
        for m in messages:
            if m.topic not in channels:
                definition, _ = ROS2.generate_msgdef(m.msgtype, ros_version=2)
                schema = writer.register_schema(m.msgtype, "ros2msg", definition.encode())
                channels[m.topic] = writer.register_channel(m.topic, "cdr", schema)
            data = bytes(ROS2.serialize_cdr(m.make(ROS2), m.msgtype))
            writer.add_message(channels[m.topic], m.log_time_ns, data, m.log_time_ns)
        for topic, log_time_ns, encoding, payload in foreign:
            channel = writer.register_channel(topic, encoding, 0)
            writer.add_message(channel, log_time_ns, payload, log_time_ns)
        writer.finish()
    return path
