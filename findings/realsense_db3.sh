#!/usr/bin/env bash
# A RealSense camera whose depth has steps of 0.1 mm (as a D405) sees a wall 1.5 m away, and its own library records it, since 2.59 into a
# .db3 of ROS 2. What do readers of ROS messages find? Guess: a ROS 2 bag like any other: the time of each frame as its
# header's stamp, depth in millimetres, as 16UC1 has it (REP 118), and a `distortion_model` that says how the lens bends.
# Seen with pyrealsense2 2.59.1.11053 on 2026-11-29, by its software device, for frames of 14 November 2023:
# - stamps and record times count from the start of the recording, so each begins in 1970. The camera's clock is in text alone,
#   "timestamp=1700000000000.000000" in a String on /image/metadata: two cameras that ran together have no common time
# - depth has the raw steps: the wall is 15000, 15 m for whoever takes 16UC1 for millimetres. That a step is 0.0001 m is in a String, too
# - a lens of the inverse Brown-Conrady model, whose coefficients lead from a pixel to its ray, is "plumb_bob", whose lead the other way
# Kannala-Brandt becomes "equidistant", which is right, and so are the mounts on /tf_static.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check pyrealsense2==2.59.1.11053 numpy==2.4.6 rosbags==0.11.9 pillow==13.0.0
cd "$folder"
cat >record.py <<'PYTHON'
import time

import numpy as np
import pyrealsense2 as rs

device = rs.software_device()
sensor = device.add_sensor("Stereo Module")
lens, stream = rs.intrinsics(), rs.video_stream()
lens.width, lens.height, lens.ppx, lens.ppy, lens.fx, lens.fy = 64, 48, 32, 24, 50, 50
lens.model, lens.coeffs = rs.distortion.inverse_brown_conrady, [0.1, 0.2, 0.3, 0.4, 0.5]
stream.type, stream.index, stream.uid, stream.fps, stream.bpp, stream.fmt = rs.stream.depth, 0, 1, 30, 2, rs.format.z16
stream.width, stream.height, stream.intrinsics = 64, 48, lens
depth = sensor.add_video_stream(stream)
sensor.add_read_only_option(rs.option.depth_units, 0.0001)
recorder = rs.recorder("camera.db3", device)
recorded, queue = recorder.query_sensors()[0], rs.frame_queue(50)
recorded.open(depth)
recorded.start(queue)
for number in range(5):
    frame = rs.software_video_frame()
    frame.pixels, frame.bpp, frame.stride, frame.depth_units = np.full((48, 64), 15000, "uint16"), 2, 128, 0.0001
    frame.timestamp, frame.domain = 1_700_000_000_000.0 + 33 * number, rs.timestamp_domain.system_time
    frame.frame_number, frame.profile = number, depth.as_video_stream_profile()
    sensor.on_video_frame(frame)
    time.sleep(0.03)
time.sleep(0.5)
recorded.stop()
recorded.close()
PYTHON
venv/bin/python record.py
venv/bin/python - <<'PYTHON'
import io
import sqlite3

import numpy as np
from PIL import Image
from rosbags.typesys import Stores, get_typestore

store = get_typestore(Stores.ROS2_JAZZY)
found = {}
query = "SELECT name, type, timestamp, data FROM messages JOIN topics ON topics.id = topic_id ORDER BY timestamp"
for topic, kind, time_ns, data in sqlite3.connect("camera.db3").execute(query):
    if kind in store.types:
        found.setdefault(topic.removeprefix("/device_0/sensor_0/Depth_0/"), (time_ns, store.deserialize_cdr(data, kind)))

time_ns, image = found["image/data/compressedDepth"]
pixels = np.array(Image.open(io.BytesIO(bytes(image.data[12:]))))
camera, facts, lens = (found[name][1] for name in ("image/camera_info", "image/metadata", "camera_info"))
print(f"stamp {image.header.stamp.sec} s, recorded {time_ns * 1e-9:.3f} s, {image.format}, {np.unique(pixels)}, {camera.distortion_model}")
print(facts.data, lens.data, sep="\n")
assert image.header.stamp.sec < 60 and time_ns < 60 * 10**9
assert image.format.startswith("16UC1") and np.all(pixels == 15000)
assert camera.distortion_model == "plumb_bob" and len(camera.d) == 5
assert "timestamp=1700000000000.000000" in facts.data and "depth_units=0.000100" in facts.data and "Inverse Brown Conrady" in lens.data
PYTHON
