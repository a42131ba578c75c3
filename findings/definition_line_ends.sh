#!/usr/bin/env bash
# A message definition comes from a .msg file with Windows line ends (CR LF), as git makes them there. Who reads the recording?
# Guess: everyone, since to a parser of definitions such a line end is white space. Seen on 2026-11-28:
#   mcap 1.6.0 with mcap-ros2-support 0.6.0 (its parser is that of ROS 2)   reads the messages
#   rosbags 0.11.9   refuses the whole recording, its other topics included: "Could not parse", at the first CR
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check mcap==1.6.0 mcap-ros2-support==0.6.0 rosbags==0.11.9
cd "$folder"
venv/bin/python - <<'PYTHON'
from pathlib import Path

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from mcap_ros2.writer import Writer
from rosbags.highlevel import AnyReader, AnyReaderError

DEFINITION = "float64 range  # metres\nfloat64 bearing\n"


def record(path, line_end):
    """Record a topic of an own type and one of a standard type."""
    with Path(path).open("wb") as file:
        writer = Writer(file)
        own = writer.register_msgdef("acme_msgs/msg/Echo", DEFINITION.replace("\n", line_end))
        text = writer.register_msgdef("std_msgs/msg/String", "string data\n")
        writer.write_message("/echo", own, {"range": 4.5, "bearing": 0.25}, log_time=1, publish_time=1)
        writer.write_message("/log", text, {"data": "hello"}, log_time=2, publish_time=2)
        writer.finish()


def read_by_mcap(path):
    with Path(path).open("rb") as file:
        messages = make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages()
        return [channel.topic for _, channel, _, _ in messages]


def read_by_rosbags(path):
    with AnyReader([Path(path)]) as reader:
        return [connection.topic for connection, _, _ in reader.messages()]


record("lf.mcap", "\n")
record("crlf.mcap", "\r\n")
for read in (read_by_mcap, read_by_rosbags):
    assert read("lf.mcap") == ["/echo", "/log"]
print("mcap:", read_by_mcap("crlf.mcap"))
assert read_by_mcap("crlf.mcap") == ["/echo", "/log"]
try:
    read_by_rosbags("crlf.mcap")
except AnyReaderError as error:
    print(f"rosbags: {str(error)!r}")
else:
    raise SystemExit("rosbags reads it now")
PYTHON
