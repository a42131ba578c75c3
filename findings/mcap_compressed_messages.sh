#!/usr/bin/env bash
# What do readers make of an MCAP whose messages rosbag2 compressed one by one (`--compression-mode message`)? Only the
# metadata.yaml of the bag says so, which a part that was copied alone lacks.
# Guess: the bytes of zstd are no CDR, so every reader refuses them.
# Seen on 2026-11-28, for a Point (1.5, -2, 0.25): one refuses, one returns other numbers without a word.
#   rosbags 0.11.9             Invalid or unsupported CDR encapsulation.
#   mcap-ros2-support 0.6.0    Point(x=7.5e-304, y=4.1e-312, z=2.7e+154)
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check \
  rosbags==0.11.9 mcap==1.6.0 mcap-ros2-support==0.6.0 zstandard==0.25.0
"$folder/venv/bin/python" - "$folder/part.mcap" <<'PYTHON'
import struct
import sys
from pathlib import Path

import zstandard
from mcap.writer import Writer
from mcap_ros2.reader import read_ros2_messages
from rosbags.highlevel import AnyReader
from rosbags.highlevel.anyreader import AnyReaderError

file = Path(sys.argv[1])
message = b"\0\1\0\0" + struct.pack("<3d", 1.5, -2.0, 0.25)
with file.open("wb") as stream:
    writer = Writer(stream)
    writer.start(profile="ros2")
    schema = writer.register_schema("geometry_msgs/msg/Point", "ros2msg", b"float64 x\nfloat64 y\nfloat64 z\n")
    writer.add_message(writer.register_channel("/point", "cdr", schema), 0, zstandard.compress(message), 0)
    writer.finish()

try:
    with AnyReader([file]) as reader:
        for connection, _, data in reader.messages():
            refusal = f"read {reader.deserialize(data, connection.msgtype)}"
except AnyReaderError as err:
    refusal = str(err)
print(f"rosbags: {refusal}")
(one,) = read_ros2_messages(str(file))
print(f"mcap-ros2-support: {one.ros_msg}")
assert "CDR encapsulation" in refusal
assert (one.ros_msg.x, one.ros_msg.y, one.ros_msg.z) != (1.5, -2.0, 0.25)
PYTHON
