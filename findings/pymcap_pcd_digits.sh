#!/usr/bin/env bash
# Clouds of a lidar, organised by ring and column, with the absolute time of each point as Hesai's driver has it (`timestamp`, seconds since 1970, float64), are exported from MCAP as PCD:
# `pymcap-cli export-pcd`. Guess: the same points, with the digits that their types have, in rows and columns; NaN for what has no return.
# Seen with pymcap-cli 0.34.0 and pypcd4 1.5.1 on 2026-11-30, without a word: text with SIX digits, whatever SIZE in the header says.
# - all points of a sweep, and of the next hour, have one time, 1.7e+09
# - a point of a map, 4321.98765 m away, is at 4321.99; one at 123.456789 at 123.457
# - what has no return is left out, and two rings of three points are one row of five: ring and column of a point can no longer be told by its place
# Integers (ring, nanoseconds since the header's stamp) are whole.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check "pymcap-cli[pointcloud]==0.34.0" rosbags==0.11.9 pypcd4==1.5.1 numpy==2.4.6
cat > write.py <<'PYTHON'
from pathlib import Path

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

store = get_typestore(Stores.ROS2_HUMBLE)
types, cloud = store.types, "sensor_msgs/msg/PointCloud2"
points = np.zeros((2, 3), [("x", "f4"), ("y", "f4"), ("z", "f4"), ("ring", "u4"), ("timestamp", "f8")])
points["x"] = [[123.456789, -98.7654321, 7], [np.nan, 4321.98765, 5]]
points["ring"] = [[123456789], [1]]
points["timestamp"] = 1_700_000_000.25 + np.arange(6).reshape(2, 3) / 100
codes = {"f4": 7, "u4": 6, "f8": 8}
fields = [types["sensor_msgs/msg/PointField"](name, offset, codes[kind.str[1:]], 1) for name, (kind, offset) in points.dtype.fields.items()]
header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](1_700_000_000, 0), "lidar")
message = types[cloud](header, 2, 3, fields, False, points.itemsize, points.itemsize * 3, points.view(np.uint8).ravel(), False)
with Writer(Path("drive"), version=9, storage_plugin=StoragePlugin.MCAP) as writer:
    writer.write(writer.add_connection("/points", cloud, typestore=store), 1, store.serialize_cdr(message, cloud))
PYTHON
venv/bin/python write.py
venv/bin/pymcap-cli --quiet export-pcd drive/drive.mcap -o pcd > log.txt 2>&1
cat > read.py <<'PYTHON'
from pathlib import Path

from pypcd4 import PointCloud

(path,) = Path("pcd").rglob("*.pcd")
print(path.read_text())
header = path.read_text().splitlines()
assert {"SIZE 4 4 4 4 8", "TYPE F F F U F", "WIDTH 5", "HEIGHT 1", "DATA ascii"} <= set(header)
points = PointCloud.from_path(path).pc_data
assert set(points["timestamp"]) == {1.7e9}
assert points["x"].tolist() == points["x"].dtype.type([123.457, -98.7654, 7, 4321.99, 5]).tolist()
assert points["ring"].tolist() == [123456789] * 3 + [1] * 2
assert "WARNING" not in Path("log.txt").read_text()
PYTHON
venv/bin/python read.py
