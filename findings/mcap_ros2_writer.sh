#!/usr/bin/env bash
# A script writes messages as dictionaries with the writer of mcap-ros2-support. What if a field is misspelt or missing, has a number too
# few, or the type on a topic has changed meanwhile? Guess: an error, as the writer has the definition; a second schema is a second channel.
# Seen with mcap 1.6.0 and mcap-ros2-support 0.6.0 on 2026-11-28: each is written without a word.
# - `orientaton` for `orientation`: a quaternion of zeros; a missing field is 0, or what the definition has as default
# - two numbers for float64[3]: the third is 0; 1.7 for an int8: 1
# - a topic has the channel, and so the schema, of its first message: what is written later with another definition is read by the first
#   one: x = 1, y = 2 come back as x = 2, y = 1
# Too large a number is an error, and so is a value that is no list.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check mcap==1.6.0 mcap-ros2-support==0.6.0
"$folder/venv/bin/python" - <<'PYTHON'
import io

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from mcap_ros2.writer import Writer

QUATERNION = "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n"
POSE = "demo_msgs/Quaternion orientation\nfloat64[3] position\nint8 quality 5\n" + "=" * 80
POSE += "\nMSG: demo_msgs/Quaternion\n" + QUATERNION
UPRIGHT = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}

file = io.BytesIO()
writer = Writer(file)
pose = writer.register_msgdef("demo_msgs/msg/Pose", POSE)
writer.write_message("/pose", pose, {"orientaton": UPRIGHT, "position": [1.0, 2.0]}, log_time=1)
writer.write_message("/pose", pose, {"orientation": UPRIGHT, "position": [1.0, 2.0, 3.0], "quality": 1.7}, log_time=2)
before = writer.register_msgdef("demo_msgs/msg/Goal", "float64 x\nfloat64 y\n")
after = writer.register_msgdef("demo_msgs/msg/Goal", "float64 y\nfloat64 x\n")
for log_time, schema in ((3, before), (4, after)):
    writer.write_message("/goal", schema, {"x": 1.0, "y": 2.0}, log_time=log_time)
for wrong in ({"quality": 200}, {"position": 1.0}):
    try:
        writer.write_message("/pose", pose, {"orientation": UPRIGHT} | wrong, log_time=5)
    except Exception as error:
        print(f"{wrong}: {type(error).__name__}: {error}")
    else:
        raise SystemExit(f"{wrong} is written")
writer.finish()
file.seek(0)
first, second, goal, changed = [
    message for *_, message in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages()
]
print(first, second, goal, changed, sep="\n")
assert before.id != after.id
assert (first.orientation.w, list(first.position), first.quality) == (0.0, [1.0, 2.0, 0.0], 5)
assert (second.orientation.w, second.quality) == (1.0, 1)
assert (goal.x, goal.y) == (1.0, 2.0)
assert (changed.x, changed.y) == (2.0, 1.0)
PYTHON
