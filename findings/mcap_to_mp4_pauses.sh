#!/usr/bin/env bash
# A camera has ten pictures in a second, then a pause of five seconds, as when a recorder waits, then ten again. `mcap-to-mp4` makes a video of its topic.
# Guess: frames at their times, with the pause. Seen with mcap-to-mp4 0.6.0 on 2026-11-30, as it is set up, without a word: frames lie evenly between
# the first and the last, so that the tenth, of 0.9 s, is at 3.27 s. (`--timestamp-timing` is there for their times; it wants a program `ffmpeg`. What it
# makes of layouts of pixels is in `mcap_to_mp4_layouts`.)
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check mcap-to-mp4==0.6.0 rosbags==0.11.9 pillow==11.3.0 av==13.1.0 numpy==2.4.6
cat > write.py <<'PYTHON'
from pathlib import Path

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

store = get_typestore(Stores.ROS2_HUMBLE)
types, image = store.types, "sensor_msgs/msg/Image"
pixels = np.tile(np.uint8([200, 40, 30]), (64, 64, 1))
with Writer(Path("drive"), version=9, storage_plugin=StoragePlugin.MCAP) as writer:
    topic = writer.add_connection("/camera", image, typestore=store)
    for number in [*range(10), *range(60, 70)]:
        stamp = types["builtin_interfaces/msg/Time"](1_700_000_000 + number // 10, number % 10 * 100_000_000)
        header = types["std_msgs/msg/Header"](stamp, "camera")
        message = types[image](header, 64, 64, "rgb8", 0, 192, pixels.ravel())
        writer.write(topic, stamp.sec * 10**9 + stamp.nanosec, store.serialize_cdr(message, image))
PYTHON
venv/bin/python write.py
venv/bin/mcap-to-mp4 drive/drive.mcap -t /camera -o camera.mp4 > said.txt 2>&1
cat > read.py <<'PYTHON'
from pathlib import Path

import av
import numpy as np

with av.open("camera.mp4") as container:
    times_s = [float(frame.time) for frame in container.decode(video=0)]
print([round(time_s, 2) for time_s in times_s])
assert len(times_s) == 20
assert np.allclose(np.diff(times_s), 6.9 / 19, atol=0.01)
assert abs(times_s[9] - 3.27) < 0.01
assert not any(word in Path("said.txt").read_text() for word in ("arning", "rror"))
PYTHON
venv/bin/python read.py
