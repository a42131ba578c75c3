#!/usr/bin/env bash
# Does rosbags-image look at `step` of sensor_msgs/Image, the bytes from one row to the next, which may be padded?
# Guess: yes, since `step` is there for nothing else. Seen with rosbags-image 0.10.4 on 2026-11-28: no. It takes the padding
# for pixels and leaves out as many at the end, so that each row is shifted further than the one before, without a word.
# Drivers pad rows whose width is no multiple of 4, 16 or 64 bytes, and a region of a larger image has its step.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check 'rosbags-image[opencv-headless]==0.10.4' rosbags==0.11.9
"$folder/venv/bin/python" - <<'PYTHON'
import numpy as np
from rosbags.image import message_to_cvimage
from rosbags.typesys import Stores, get_typestore

types = get_typestore(Stores.ROS2_HUMBLE).types
header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](0, 0), "camera")


def read(rows, width, step):
    """Return what the library makes of rows of grey pixels, each padded with 99 to `step` bytes."""
    data = b"".join(bytes(row).ljust(step, b"c") for row in rows)
    image = types["sensor_msgs/msg/Image"](
        header, len(rows), width, "mono8", 0, step, np.frombuffer(data, np.uint8)
    )
    return message_to_cvimage(image).tolist()


rows = [[1, 2, 3], [4, 5, 6], [7, 8, 9]]
plain, padded = read(rows, width=3, step=3), read(rows, width=3, step=4)
print("step 3:", plain)
print("step 4:", padded)
assert plain == rows
assert padded == [[1, 2, 3], [99, 4, 5], [6, 99, 7]]
PYTHON
