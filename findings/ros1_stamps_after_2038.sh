#!/usr/bin/env bash
# A receiver with a week rollover, or a simulator, stamps a ROS 1 message in 2046. ROS 1 has 32 bits without a sign for the seconds. When is it?
# Guess: in 2046, for every reader, as the layout of `time` has been the same since the beginning.
# Seen on 2026-11-28: mcap-ros1-support 0.9.0, with ROS 1's own genpy, says so. rosbags 0.11.9 takes the type of ROS 2 for it, whose seconds
# have a sign: -1894967296, which is in 1909, without a word. Its writer refuses stamps from 2038 on.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check rosbags==0.11.9 mcap==1.6.0 mcap-ros1-support==0.9.0
cd "$folder"
venv/bin/python - <<'PYTHON'
import struct

from mcap.records import Schema
from mcap_ros1.decoder import DecoderFactory
from rosbags.typesys import Stores, get_typestore

SECONDS, TYPE = 2_400_000_000, "std_msgs/msg/Header"
store = get_typestore(Stores.ROS1_NOETIC)
data = struct.pack("<IIII", 7, SECONDS, 5, 3) + b"gps"
definition = store.generate_msgdef(TYPE, ros_version=1)[0].encode()
by_mcap = DecoderFactory().decoder_for("ros1", Schema(1, definition, "ros1msg", "std_msgs/Header"))(data)
by_rosbags = store.deserialize_ros1(data, TYPE)
print(f"mcap-ros1-support: {by_mcap.stamp.secs}; rosbags: {by_rosbags.stamp.sec}")
assert by_mcap.stamp.secs == SECONDS
assert by_rosbags.stamp.sec == SECONDS - 2**32
by_rosbags.stamp.__dict__["sec"] = SECONDS
try:
    store.serialize_ros1(by_rosbags, TYPE)
except Exception as error:
    print(f"rosbags writes: {type(error).__name__}: {error}")
else:
    raise SystemExit("rosbags writes it")
PYTHON
