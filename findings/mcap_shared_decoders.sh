#!/usr/bin/env bash
# A script goes through the recordings of a fleet and makes one DecoderFactory for all of them, as it has no argument and takes no file.
# What does the second recording hold? Guess: what was recorded, since decoder_for() is given the schema of each message.
# Seen with mcap 1.6.0, mcap-ros2-support 0.6.0 (the one of mcap-ros2-support-fast 0.8.0 likewise), mcap-ros1-support 0.9.0 and
# mcap-protobuf-support 0.6.0 on 2026-11-29: it remembers a decoder by the schema's number alone, which counts from 1 in each file. Whatever
# type has number 1 in the second file is decoded as that of the first, without a word wherever its bytes are enough: poses that are read
# after a file of twists are velocities. A factory for each file is right.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check mcap==1.6.0 mcap-ros1-support==0.9.0 mcap-ros2-support==0.6.0 \
  mcap-ros2-support-fast==0.8.0 mcap-protobuf-support==0.6.0 protobuf==7.36.2
cd "$folder"
venv/bin/python - <<'PYTHON'
import struct

import mcap_protobuf.decoder
import mcap_ros1.decoder
import mcap_ros2.decoder
import mcap_ros2_support_fast.decoder
from google.protobuf.duration_pb2 import Duration
from google.protobuf.timestamp_pb2 import Timestamp
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_protobuf.schema import build_file_descriptor_set

TWIST = "float64 linear\nfloat64 angular\n"
POSE = "float64 x\nfloat64 y\nfloat64 z\n"


def record(path, encodings, name, definition, data):
    """Write a recording of one message, with the only schema of the file."""
    with open(path, "wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema(name, encodings[0], definition)
        writer.add_message(writer.register_channel("/topic", encodings[1], schema), 0, data, 0)
        writer.finish()


def read(path, factory):
    """Return the name of the type that the file gives, and the message."""
    with open(path, "rb") as file:
        schema, _, _, message = next(make_reader(file, decoder_factories=[factory]).iter_decoded_messages())
    return schema.name, message


def of_two(factory):
    """Return the message of b.mcap, by a factory that has read a.mcap, and by a new one."""
    shared = factory()
    read("a.mcap", shared)
    return read("b.mcap", shared), read("b.mcap", factory())


numbers = struct.pack("<3d", 1.5, -2.0, 0.25)
for factory in (mcap_ros2.decoder.DecoderFactory, mcap_ros2_support_fast.decoder.DecoderFactory):
    record("a.mcap", ("ros2msg", "cdr"), "fleet_msgs/msg/Twist", TWIST.encode(), b"\0\1\0\0" + numbers[:16])
    record("b.mcap", ("ros2msg", "cdr"), "fleet_msgs/msg/Pose", POSE.encode(), b"\0\1\0\0" + numbers)
    (name, shared), (_, own) = of_two(factory)
    print(f"{factory.__module__}: {name} is {shared}")
    assert (shared.linear, shared.angular) == (1.5, -2.0)
    assert not hasattr(shared, "x")
    assert (own.x, own.y, own.z) == (1.5, -2.0, 0.25)

record("a.mcap", ("ros1msg", "ros1"), "fleet_msgs/Twist", TWIST.encode(), numbers[:16])
record("b.mcap", ("ros1msg", "ros1"), "fleet_msgs/Pose", POSE.encode(), numbers)
(name, shared), (_, own) = of_two(mcap_ros1.decoder.DecoderFactory)
print(f"ROS 1: {name} has linear {shared.linear}, angular {shared.angular}")
assert (shared.linear, shared.angular) == (1.5, -2.0)
assert (own.x, own.y, own.z) == (1.5, -2.0, 0.25)

for path, message in (("a.mcap", Timestamp(seconds=1)), ("b.mcap", Duration(seconds=5))):
    definition = build_file_descriptor_set(type(message)).SerializeToString()
    record(path, ("protobuf", "protobuf"), message.DESCRIPTOR.full_name, definition, message.SerializeToString())
(name, shared), (_, own) = of_two(mcap_protobuf.decoder.DecoderFactory)
print(f"protobuf: {name} is a {shared.DESCRIPTOR.full_name}")
assert name == own.DESCRIPTOR.full_name == "google.protobuf.Duration"
assert shared.DESCRIPTOR.full_name == "google.protobuf.Timestamp"
PYTHON
