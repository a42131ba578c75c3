#!/usr/bin/env bash
# A cloud has a point 10 m straight ahead (y is 0), one to the left (x is 0), one at the height of the lidar (z is 0), one beside these axes, and a shot that hit
# nothing, which the driver puts at (0, 0, 0). And a laser that scans a plane sends clouds whose z is always 0. They are read from a bag with
# pointcloudset, which leaves out zeros (`keep_zeros=False`, as it is set up). Guess: four points, and all of the plane; only (0, 0, 0) is missing.
# Seen with pointcloudset 0.14.0 on 2026-11-29, without a word:
# - one point is left, that beside the axes, as each point goes of which ANY coordinate is 0; of the plane, none
# - where fields are not listed in the order in which they lie in memory, values have the names of others: of intensity, x, y, z, with intensity behind
#   the others, x is in the column `intensity`
# `keep_zeros=True` keeps all, the shots at (0, 0, 0) as well.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check pointcloudset==0.14.0 rosbags==0.9.23 numpy==2.4.6
cd "$folder"
venv/bin/python -W ignore - <<'PYTHON'
from pathlib import Path

import numpy as np
from pointcloudset import Dataset
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore

CLOUD = "sensor_msgs/msg/PointCloud2"
POINTS = np.array([[10, 0, 1, 5], [0, 10, 1, 6], [10, 3, 0, 7], [10, 3, 1, 8], [0, 0, 0, 0]], np.float32)
PLANE = np.array([[10, 3, 0, 5], [9, -3, 0, 6]], np.float32)

store = get_typestore(Stores.ROS1_NOETIC)
time, header, field, cloud = (store.types[name] for name in ("builtin_interfaces/msg/Time", "std_msgs/msg/Header", "sensor_msgs/msg/PointField", CLOUD))


def message(points, names):
    offsets = {"x": 0, "y": 4, "z": 8, "intensity": 12}
    fields = [field(name, offsets[name], 7, 1) for name in names]
    data = np.frombuffer(points.tobytes(), np.uint8)
    return cloud(header(0, time(100, 0), "lidar"), 1, len(points), fields, False, 16, 16 * len(points), data, True)


usual = ["x", "y", "z", "intensity"]
topics = {"/points": message(POINTS, usual), "/plane": message(PLANE, usual), "/listed_otherwise": message(POINTS[3:4], usual[3:] + usual[:3])}
with Writer(Path("drive.bag")) as bag:
    for topic, sent in topics.items():
        bag.write(bag.add_connection(topic, CLOUD, typestore=store), 100 * 10**9, store.serialize_ros1(sent, CLOUD))


def read(topic, **options):
    return Dataset.from_file(Path("drive.bag"), topic=topic, **options)[0].data


for topic in topics:
    table = read(topic)
    print(f"{topic}: {table.drop(columns='original_id').to_dict('records')}")
assert read("/points")[usual].to_numpy().tolist() == [[10, 3, 1, 8]]
assert len(read("/plane")) == 0 and len(read("/plane", keep_zeros=True)) == 2
assert len(read("/points", keep_zeros=True)) == len(POINTS)
(row,) = read("/listed_otherwise", keep_zeros=True).to_dict("records")
assert (row["intensity"], row["x"], row["y"], row["z"]) == (10, 3, 1, 8)
PYTHON
