#!/usr/bin/env bash
# A ROS 2 bag of 3 s has a mount of the lidar in /tf_static, sent once, and a cloud per second, 3 rows of 4 points, each row padded to 80 bytes (`row_step`), as drivers do that
# align rows. rosbag-filter cuts it: all of it, from 0 to its duration, with points ahead alone (`--pc2-x-min 0.5`); and its second half.
# Guess: all messages; the points ahead; and a second half with the mount, or a word that it has none.
# Seen with rosbag-filter 0.2.0 and rosbags 0.9.23 on 2026-11-30, without a word ("Filtered bag written"):
# - the last message is not in what is cut from the beginning to the end, as the end does not belong to the window
# - of 12 points ahead 10 are left: the padding at the end of the first two rows is taken for a point each, at the lidar, and so the last two points are never looked at. Without `--pc2-x-min 0.5`
#   (with -0.5), both of the padding are points of the new cloud, in place of the last two
# - the second half has no /tf_static, so that nobody can place its clouds
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check rosbag-filter==0.2.0 rosbags==0.9.23 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import subprocess
from pathlib import Path

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_HUMBLE)
CLOUD, TF = "sensor_msgs/msg/PointCloud2", "tf2_msgs/msg/TFMessage"
ROWS, COLUMNS, ROW_BYTES, START_NS = 3, 4, 80, 1_700_000_000 * 10**9


def of(name, *values):
    return STORE.types[name](*values)


def header(frame):
    return of("std_msgs/msg/Header", of("builtin_interfaces/msg/Time", 1_700_000_000, 0), frame)


def cloud():
    """Return 12 points, 1 to 12 m ahead."""
    data = np.zeros((ROWS, ROW_BYTES), np.uint8)
    points = np.zeros((ROWS, COLUMNS, 4), np.float32)
    points[..., 0] = np.arange(1, 13).reshape(ROWS, COLUMNS)
    data[:, : COLUMNS * 16] = points.reshape(ROWS, -1).view(np.uint8)
    fields = [of("sensor_msgs/msg/PointField", name, 4 * index, 7, 1) for index, name in enumerate(("x", "y", "z", "i"))]
    return of(CLOUD, header("lidar"), ROWS, COLUMNS, fields, False, 16, ROW_BYTES, data.reshape(-1), True)


zero, straight = of("geometry_msgs/msg/Vector3", 1.0, 0.0, 2.0), of("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0)
mount = of("geometry_msgs/msg/TransformStamped", header("base"), "lidar", of("geometry_msgs/msg/Transform", zero, straight))
with Writer(Path("drive")) as writer:
    static = writer.add_connection("/tf_static", TF, typestore=STORE)
    lidar = writer.add_connection("/points", CLOUD, typestore=STORE)
    writer.write(static, START_NS, STORE.serialize_cdr(of(TF, [mount]), TF))
    for second in range(4):
        writer.write(lidar, START_NS + second * 10**9, STORE.serialize_cdr(cloud(), CLOUD))


def cut(name, start, end, *more):
    """Return topics and times of the messages of a part, and x of the points of its first cloud."""
    window = ["--time-mode", "relative", "--start", str(start), "--end", str(end)]
    subprocess.run(["venv/bin/rosbag-filter", "--input", "drive", "--output", name, *window, *more], check=True, capture_output=True)
    with AnyReader([Path(name)]) as reader:
        messages = [(one.topic, (time - START_NS) / 1e9, reader.deserialize(data, one.msgtype)) for one, time, data in reader.messages()]
    points = next(message for topic, _, message in messages if topic == "/points")
    return [(topic, time) for topic, time, _ in messages], points.data.view(np.float32).reshape(-1, 4)[:, 0]


whole, ahead = cut("whole", 0, 3, "--pc2-topic", "/points", "--pc2-x-min", "0.5")
_, around = cut("around", 0, 3, "--pc2-topic", "/points", "--pc2-x-min", "-0.5")
half, _ = cut("half", 1.5, 3.5)
print("the whole:", whole, "ahead:", ahead, "around:", around)
print("the second half:", half)
assert whole == [("/tf_static", 0), ("/points", 0), ("/points", 1), ("/points", 2)]
assert ahead.tolist() == [1, 2, 3, 4, 5, 6, 7, 8, 9, 10]
assert around.tolist() == [1, 2, 3, 4, 0, 5, 6, 7, 8, 0, 9, 10]
assert half == [("/points", 2), ("/points", 3)]
PYTHON
