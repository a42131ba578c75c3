#!/usr/bin/env bash
# An arm publishes joint positions and efforts, but no velocities: the usual sensor_msgs/JointState. What does pybag read of it?
# Guess: what was written, since CDR needs nothing special for an empty sequence.
# Seen with pybag-sdk 0.13.0 on 2026-11-28: it skips to the alignment of float64 after the length of an empty float64[], where CDR
# has no padding (Fast-CDR and rosbags write none). Of positions and efforts it returns the positions and no efforts, without a word;
# of positions alone it raises struct.error. Its own writer pads nothing, so it cannot read back what it wrote. If all three
# fields are full, all is well.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check pybag-sdk==0.13.0 rosbags==0.11.9 numpy==2.4.6
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
import logging
import struct
from pathlib import Path

import numpy as np
from pybag.mcap_reader import McapFileReader
from pybag.mcap_writer import McapFileWriter
from pybag.ros2.humble.builtin_interfaces import Time
from pybag.ros2.humble.sensor_msgs import JointState
from pybag.ros2.humble.std_msgs import Header
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

logging.disable()
TYPE = "sensor_msgs/msg/JointState"
store = get_typestore(Stores.ROS2_HUMBLE)
made = store.types


def write_rosbags(path, fields):
    stamp = made["builtin_interfaces/msg/Time"](1, 2)
    message = made[TYPE](made["std_msgs/msg/Header"](stamp, "arm"), ["elbow"], *map(np.array, fields))
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/joint_states", TYPE, typestore=store)
        writer.write(connection, 1, store.serialize_cdr(message, TYPE))
    return next(path.glob("*.mcap"))


def write_pybag(path, fields):
    position, velocity, effort = fields
    header = Header(stamp=Time(sec=1, nanosec=2), frame_id="arm")
    message = JointState(header=header, name=["elbow"], position=position, velocity=velocity, effort=effort)
    with McapFileWriter.open(path) as writer:
        writer.write_message("/joint_states", 1, message)
    return path


def read(path):
    try:
        message = next(iter(McapFileReader.from_file(path).messages("/joint_states"))).data
    except struct.error:
        return "struct.error"
    return [list(message.position), list(message.velocity), list(message.effort)]


EXPECTED = {
    ((1.0,), (2.0,), (3.0,)): [[1.0], [2.0], [3.0]],
    ((1.0,), (), (3.0,)): [[1.0], [], []],
    ((1.0,), (), ()): "struct.error",
}
for number, (fields, expected) in enumerate(EXPECTED.items()):
    fields = [list(map(float, field)) for field in fields]
    for write, name in ((write_rosbags, f"r{number}"), (write_pybag, f"p{number}.mcap")):
        found = read(write(Path(name), fields))
        print(f"{write.__name__} {fields}: pybag reads {found}")
        assert found == expected, (name, found, expected)
PYTHON
