#!/usr/bin/env bash
# Are `byte` and `char` of a ROS 2 message signed?
# Guess: the libraries agree, as the interface definition says: byte is octet, char is uint8, so both are unsigned.
# Seen on 2026-11-28: they disagree on both, and each is wrong about one. For the bytes 200 and 201 of `byte b`, `char c`
#   rosbags 0.11.9             b = -56, c = 201
#   mcap-ros2-support 0.6.0    b = 200, c = -55
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check rosbags==0.11.9 mcap==1.6.0 mcap-ros2-support==0.6.0
"$folder/venv/bin/python" - <<'PYTHON'
import io

from mcap.writer import Writer
from mcap_ros2.reader import read_ros2_messages
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

DEFINITION = "byte b\nchar c\n"
DATA = bytes([0, 1, 0, 0, 200, 201])

store = get_typestore(Stores.ROS2_HUMBLE)
store.register(get_types_from_msg(DEFINITION, "a/msg/Pair"))
one = store.deserialize_cdr(DATA, "a/msg/Pair")

stream = io.BytesIO()
writer = Writer(stream)
writer.start(profile="ros2")
schema = writer.register_schema("a/msg/Pair", "ros2msg", DEFINITION.encode())
writer.add_message(writer.register_channel("/pair", "cdr", schema), 0, DATA, 0)
writer.finish()
stream.seek(0)
other = next(iter(read_ros2_messages(stream))).ros_msg

print(f"rosbags: byte {one.b}, char {one.c}; mcap-ros2-support: byte {other.b}, char {other.c}")
assert (one.b, one.c) == (-56, 201)
assert (other.b, other.c) == (200, -55)
PYTHON
