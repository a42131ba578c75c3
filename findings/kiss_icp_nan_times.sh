#!/usr/bin/env bash
# Does kiss-icp deskew an organised cloud in which lost returns are NaN, as most drivers publish them?
# Guess: a NaN point goes together with its time. Seen with kiss-icp 1.3.0 on 2026-11-28: its reader of PointCloud2 drops
# NaN points and keeps their times, and deskewing takes times by number. Every point behind the first NaN is given the
# time of an earlier one: here half a revolution off, so that at one metre per revolution points are 0.5 m off, silently.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check kiss-icp==1.3.0 rosbags==0.11.9 numpy==2.4.6
"$folder/venv/bin/python" - <<'PYTHON'
import numpy as np
from kiss_icp.config import KISSConfig
from kiss_icp.preprocess import get_preprocessor
from kiss_icp.tools.point_cloud2 import read_point_cloud
from rosbags.typesys import Stores, get_typestore

NUMBER = 200
LOST = slice(50, 150)
cloud = np.zeros(NUMBER, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("t", "<f4")])
cloud["x"], cloud["t"] = 10.0, np.linspace(0.0, 1.0, NUMBER)
for name in "xyz":
    cloud[name][LOST] = np.nan
types = get_typestore(Stores.ROS2_HUMBLE).types
header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](0, 0), "lidar")
fields = [types["sensor_msgs/msg/PointField"](name, 4 * i, 7, 1) for i, name in enumerate("xyzt")]
data = np.frombuffer(cloud.tobytes(), np.uint8)
message = types["sensor_msgs/msg/PointCloud2"](header, 1, NUMBER, fields, False, 16, 16 * NUMBER, data, False)

config = KISSConfig()
config.data.deskew, config.data.min_range, config.data.max_range = True, 0.0, 100.0
config.registration.max_num_threads = 1
motion = np.eye(4)
motion[0, 3] = 1.0  # one metre ahead per revolution

points, times = read_point_cloud(message)
kept = np.delete(times, np.arange(NUMBER)[LOST])
deskew = get_preprocessor(config).preprocess
apart_m = np.abs(deskew(points, times, motion) - deskew(points, kept, motion))[:, 0]
print(f"{len(points)} points, {len(times)} times; off by {apart_m[:50].max():.3f} m before the gap, "
      f"by {apart_m[50:].min():.3f} to {apart_m[50:].max():.3f} m behind it")
assert (len(points), len(times)) == (100, 200)
assert apart_m[:50].max() < 1e-9
assert np.allclose(apart_m[50:], 100 / 199, atol=1e-6)
PYTHON
