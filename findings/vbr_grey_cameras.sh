#!/usr/bin/env bash
# A ROS 1 bag has a grey camera (mono8) that sees an edge between light and dark, a colour one (bayer_rggb8) that sees a red wall, and an IMU; messages were
# recorded 30 ms after what they show. It becomes a folder in KITTI's layout with vbr-devkit, the kit of the VBR data sets (`vbr convert kitti`). Guess:
# grey and red pictures, at the times of their headers. Seen with vbr-devkit 0.1.2 on 2026-11-29, without a word: all cameras are taken for Bayer ones of
# their pattern, so that the grey one has three channels, whose edge is blurred over four pixels, with a colour of its own in each (`encoding` says rgb8).
# The times are those of recording, 30 ms late, in timestamps.txt of cameras and IMU alike; the header's are kept nowhere. The IMU's double values are
# rounded to float32 first, and written with the digits of a double.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check vbr-devkit==0.1.2 rosbags==0.11.0 rosbags-image==0.10.3 numpy==2.4.6 \
  opencv-python-headless==5.0.0.93 typer==0.29.2
cd "$folder"
cat > record.py <<'PYTHON'
import numpy as np
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore

HEIGHT, WIDTH, START_NS = 32, 48, 1_790_000_000_000_000_000
store = get_typestore(Stores.ROS1_NOETIC)
Time, Header, Image, Imu, Vector, Quaternion = (
    store.types[f"{package}/msg/{name}"]
    for package, name in [("builtin_interfaces", "Time"), ("std_msgs", "Header"), ("sensor_msgs", "Image"), ("sensor_msgs", "Imu"),
        ("geometry_msgs", "Vector3"), ("geometry_msgs", "Quaternion")]
)
grey = np.full((HEIGHT, WIDTH), 100, np.uint8)
grey[:, WIDTH // 2 :] = 20
bayer = np.zeros((HEIGHT, WIDTH), np.uint8)
bayer[0::2, 0::2] = 200
with Writer("drive.bag") as bag:
    topics = {name: bag.add_connection(name, kind.__msgtype__, typestore=store)
        for name, kind in [("/grey/image_raw", Image), ("/colour/image_raw", Image), ("/imu/data", Imu)]}
    for n in range(3):
        header = Header(n, Time((START_NS + n * 10**8) // 10**9, (START_NS + n * 10**8) % 10**9), "sensor")
        unknown, messages = np.zeros(9), {}
        messages["/grey/image_raw"] = Image(header, HEIGHT, WIDTH, "mono8", 0, WIDTH, grey.ravel())
        messages["/colour/image_raw"] = Image(header, HEIGHT, WIDTH, "bayer_rggb8", 0, WIDTH, bayer.ravel())
        messages["/imu/data"] = Imu(header, Quaternion(0.0, 0.0, 0.6, 0.8), unknown, Vector(0.1, 0.0, 0.0), unknown, Vector(0.0, 0.0, 9.81), unknown)
        for topic, message in messages.items():
            raw = store.serialize_ros1(message, message.__msgtype__)
            bag.write(topics[topic], START_NS + n * 10**8 + 30_000_000, raw)
PYTHON
venv/bin/python record.py
venv/bin/vbr convert kitti drive.bag kitti >log
venv/bin/python - <<'PYTHON'
import json
from pathlib import Path

import cv2

grey, colour = (cv2.imread(f"kitti/{name}/data/0000000000.png", cv2.IMREAD_UNCHANGED) for name in ("grey", "colour"))
edge = grey[16, 22:26].tolist()
times = {name: Path(f"kitti/{name}/timestamps.txt").read_text().split()[0] for name in ("grey", "colour", "imu")}
acceleration = Path("kitti/imu/data/imu.txt").read_text().splitlines()[1].split(",")[2]
print("grey camera, blue green red at its edge:", edge)
print("first times:", times, "acceleration:", acceleration)
assert colour[16, 24].tolist() == [0, 0, 200]
assert grey.shape == (32, 48, 3) and json.loads(Path("kitti/grey/.metadata.json").read_text())["encoding"] == "rgb8"
assert edge == [[100, 100, 100], [100, 100, 60], [60, 40, 20], [20, 20, 20]]
assert set(times.values()) == {"2026-09-21T14:13:20.030000000"}
assert acceleration == "9.8100004196167"
PYTHON
