#!/usr/bin/env bash
# A ROS 1 bag has the commands of a drone, whose definition names its constants Idle and Take_Off, as ROS 1 allows, and another topic of a
# standard type. Who reads it? Guess: everyone, since constants are not in the bytes of a message; perhaps a reader of ROS 2 forbids the names.
# Seen with rosbags 0.11.9, mcap 1.6.0, mcap-ros1-support 0.9.0 and @foxglove/rosmsg 5.0.5 on 2026-11-30: rosbags refuses the whole bag, the standard topic, too. As
# `uint8 Idle=0` it "could not parse"; as `uint8 Idle = 0`, with spaces, it takes the constant for a FIELD, whose default is text that begins with "=", and
# so has a wrong hash of the type, which it reports. The other two read the messages. (Names of packages in upper case, which ROS 1 allows, too, it refuses likewise)
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check rosbags==0.11.9 mcap==1.6.0 mcap-ros1-support==0.9.0
npm install --silent --no-fund --no-audit @foxglove/rosmsg@5.0.5 @foxglove/rosmsg-serialization@2.0.4 tslib@2.8.1 >/dev/null
cat >read.py <<'PYTHON'
import hashlib
import json
import struct
import subprocess
from pathlib import Path

from mcap.reader import make_reader
from mcap.writer import Writer as McapWriter
from mcap_ros1.decoder import DecoderFactory
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.rosbag1 import Writer as BagWriter
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore

CONSTANTS, FIELDS = ("uint8 Idle{}0", "uint8 Take_Off{}1"), ("uint8 mode", "uint8 battery", "string target")
MESSAGE = struct.pack("<BBI", 1, 80, 2) + b"up"
FLOAT = ("float64 data", "fdb28210bfa9d7c91146260178d9a584")


def by_rosbags(definition):
    # The hash of a type in ROS 1: its constants, then its fields, without comments and blanks around "=".
    text = "\n".join([one.format("=") for one in CONSTANTS] + list(FIELDS))
    with BagWriter(Path("drone.bag")) as writer:
        own = writer.add_connection("/command", "drone_msgs/msg/Command", msgdef=definition, md5sum=hashlib.md5(text.encode()).hexdigest())
        standard = writer.add_connection("/height", "std_msgs/msg/Float64", msgdef=FLOAT[0], md5sum=FLOAT[1])
        writer.write(own, 1, MESSAGE)
        writer.write(standard, 1, struct.pack("<d", 2.5))
    try:
        with AnyReader([Path("drone.bag")]) as reader:
            return [connection.topic for connection, _, _ in reader.messages()]
    except AnyReaderError as error:
        return str(error)
    finally:
        Path("drone.bag").unlink()


def by_mcap(definition):
    with open("drone.mcap", "wb") as file:
        writer = McapWriter(file)
        writer.start(profile="ros1")
        schema = writer.register_schema("drone_msgs/Command", "ros1msg", definition.encode())
        channel = writer.register_channel("/command", "ros1", schema)
        writer.add_message(channel, 1, MESSAGE, 1)
        writer.finish()
    with open("drone.mcap", "rb") as file:
        ((_, _, _, message),) = make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages()
    return [message.mode, message.battery, message.target]


def by_foxglove(definition):
    script = """
const {parse} = require("@foxglove/rosmsg"), {MessageReader} = require("@foxglove/rosmsg-serialization");
const [definition, data] = process.argv.slice(1);
const message = new MessageReader(parse(definition)).readMessage(Buffer.from(data, "hex"));
console.log(JSON.stringify([message.mode, message.battery, message.target]));"""
    return json.loads(subprocess.run(["node", "-e", script, definition, MESSAGE.hex()], check=True, stdout=subprocess.PIPE, text=True).stdout)


refused = {}
for equals in ("=", " = "):
    definition = "\n".join([one.format(equals) for one in CONSTANTS] + list(FIELDS)) + "\n"
    refused[equals] = by_rosbags(definition)
    print(repr(equals), "rosbags:", refused[equals].splitlines()[0], "- mcap:", by_mcap(definition), "- Foxglove:", by_foxglove(definition))
    assert by_mcap(definition) == by_foxglove(definition) == [1, 80, "up"]
assert refused["="].startswith("Could not parse") and "hash mismatch" in refused[" = "], refused
store = get_typestore(Stores.ROS1_NOETIC)
store.register(get_types_from_msg(definition, "drone_msgs/msg/Command"))
try:
    get_types_from_msg("AcmeRobot/Mode mode\n", "drone_msgs/msg/Command")
except TypesysError as error:
    assert "Could not parse" in str(error)
else:
    raise SystemExit("rosbags takes packages in upper case now")
fields = [name for name, _ in store.fielddefs["drone_msgs/msg/Command"][1]]
print("fields, by rosbags:", fields)
assert fields == ["Idle", "Take_Off", "mode", "battery", "target"]
PYTHON
venv/bin/python read.py
