#!/usr/bin/env bash
# Two topics of one MCAP have a type of the same name with different definitions, as in files that were merged after a package
# had changed; each channel has its own schema. By which are the messages decoded? Guess: each by its own.
# Seen on 2026-11-28, for x = 1, y = 2 before the fields changed places:
#   mcap 1.6.0 with mcap-ros2-support 0.6.0   each by its own
#   rosbags 0.11.9   both by that of the last schema: what was recorded before has x = 2, y = 1, without a word
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
from rosbags.highlevel import AnyReader

path = Path("merged.mcap")
with path.open("wb") as file:
    writer = Writer(file)
    for topic, definition in (("/before", "float32 x\nfloat32 y\n"), ("/after", "float32 y\nfloat32 x\n")):
        schema = writer.register_msgdef("acme_msgs/msg/Place", definition)
        writer.write_message(topic, schema, {"x": 1.0, "y": 2.0}, log_time=1, publish_time=1)
    writer.finish()


with path.open("rb") as file:
    messages = make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages()
    by_mcap = {channel.topic: (message.x, message.y) for _, channel, _, message in messages}
with AnyReader([path]) as reader:
    by_rosbags = {}
    for connection, _, data in reader.messages():
        message = reader.deserialize(data, connection.msgtype)
        by_rosbags[connection.topic] = (message.x, message.y)

print("mcap:   ", by_mcap)
print("rosbags:", by_rosbags)
assert by_mcap == {"/before": (1, 2), "/after": (1, 2)}
assert by_rosbags == {"/before": (2, 1), "/after": (1, 2)}
PYTHON
