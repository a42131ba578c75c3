#!/usr/bin/env bash
# `pybag convert` makes a ROS 1 bag of a ROS 2 recording. Can programs of ROS 1 read its messages?
# Guess: yes, with `seq` 0 in each header, as `rosbags-convert` does.
# Seen with pybag-sdk 0.13.0 on 2026-11-28: the bag defines std_msgs/Header without `seq`, and its messages are so. sensor_msgs/Image then
# has another MD5 sum than in ROS 1 (a node that subscribes refuses it), and whoever reads the bag with the types of Noetic takes the
# seconds of the stamp for `seq`, and text for numbers. With the definitions in the bag all is right.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check pybag-sdk==0.13.0 rosbags==0.11.9 numpy==2.4.6
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
from pathlib import Path

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

TYPE = "sensor_msgs/msg/Image"
store = get_typestore(Stores.ROS2_HUMBLE)
made = store.types
header = made["std_msgs/msg/Header"](made["builtin_interfaces/msg/Time"](1_700_000_000, 5), "cam")
image = made[TYPE](header, 2, 3, "mono8", 0, 3, np.arange(6, dtype=np.uint8))
with Writer(Path("drive"), version=9, storage_plugin=StoragePlugin.MCAP) as writer:
    connection = writer.add_connection("/image", TYPE, typestore=store)
    writer.write(connection, 1, store.serialize_cdr(image, TYPE))
PYTHON
"$folder/venv/bin/pybag" filter drive/drive.mcap --include-topic /image -o image.mcap 2>>log
"$folder/venv/bin/pybag" convert image.mcap -o pybag.bag 2>>log
"$folder/venv/bin/rosbags-convert" --src drive --dst rosbags.bag
"$folder/venv/bin/python" - <<'PYTHON'
import struct

from rosbags.rosbag1 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

NOETIC = get_typestore(Stores.ROS1_NOETIC)
digest = NOETIC.generate_msgdef("sensor_msgs/msg/Image")[1]
for name, is_of_ros1 in (("rosbags.bag", True), ("pybag.bag", False)):
    with Reader(name) as reader:
        (connection,) = reader.connections
        (raw,) = (raw for _, _, raw in reader.messages())
    own = get_typestore(Stores.EMPTY)
    own.register(get_types_from_msg(connection.msgdef.data, connection.msgtype))
    header = own.deserialize_ros1(raw, connection.msgtype).header
    print(f"{name}: MD5 {connection.digest}, of ROS 1 {digest}; begins with {struct.unpack('<3I', raw[:12])}")
    assert hasattr(header, "seq") == is_of_ros1
    assert (connection.digest == digest) == is_of_ros1
    assert (header.stamp.sec, header.stamp.nanosec, header.frame_id) == (1_700_000_000, 5, "cam")
    assert struct.unpack("<3I", raw[:12]) == ((0, 1_700_000_000, 5) if is_of_ros1 else (1_700_000_000, 5, 3))
PYTHON
