#!/usr/bin/env bash
# A SLAM node publishes its trajectory (nav_msgs/Path) again and again, each time with all poses since it began at 100 s; the recording began at 110 s, and ends at 119 s.
# Its lidar's cloud has 2 rows (rings) of 3 points. Both are read with robotdatapy, and two seconds are cut out of other poses (`clip`).
# Guess: poses at their stamps; the rows; the poses of those two seconds. Seen with robotdatapy 1.1.17 and rosbags 0.11.9 on 2026-11-30, without a word:
# - every pose is 10 s late: the poses of the last message are moved so that the first of them is at the stamp of the FIRST message. A pose in Odometry or PoseStamped is not
# - the cloud has 3 rows of 2 points: a row of it is two points of one ring, or the last of one and the first of the next
# - after `clip` from 115 to 117 s the last pose is gone from `times` and `positions`, and `all_poses` has those of the whole drive, from its beginning
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check robotdatapy==1.1.17 rosbags==0.11.9 rosbags-image==0.10.4 numpy==2.4.6 \
  scipy==1.17.1 gtsam==4.3.0 evo==1.38.1 pykitti==0.3.1 utm==0.9.0
cd "$folder"
venv/bin/python -W ignore - <<'PYTHON'
from pathlib import Path

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from robotdatapy.data import PointCloudData, PoseData

store = get_typestore(Stores.ROS2_HUMBLE)
packages = "builtin_interfaces", "std_msgs", "geometry_msgs", "nav_msgs", "sensor_msgs"
types = {name.rsplit("/", 1)[1]: kind for name, kind in store.types.items() if name.split("/")[0] in packages}


def header(second):
    return types["Header"](types["Time"](second, 0), "map")


def place(second):
    """Return where the vehicle is, metres: at 1 m/s until 110 s, at 15 m/s from then on."""
    return second - 100.0 if second < 110 else 10.0 + 15 * (second - 110.0)


def pose(second):
    at = types["Pose"](types["Point"](place(second), 0.0, 0.0), types["Quaternion"](0.0, 0.0, 0.0, 1.0))
    return types["PoseStamped"](header(second), at)


points = np.float32([[ring, shot, 0] for ring in range(2) for shot in range(3)])
fields = [types["PointField"](name, 4 * number, 7, 1) for number, name in enumerate("xyz")]
cloud = types["PointCloud2"](header(110), 2, 3, fields, False, 12, 36, points.view(np.uint8).ravel(), True)
with Writer(Path("drive"), version=9, storage_plugin=StoragePlugin.MCAP) as writer:
    kinds = {"/path": "nav_msgs/msg/Path", "/pose": "geometry_msgs/msg/PoseStamped", "/points": "sensor_msgs/msg/PointCloud2"}
    topics = {topic: writer.add_connection(topic, kind, typestore=store) for topic, kind in kinds.items()}
    for second in range(110, 120):
        path = types["Path"](header(second), [pose(each) for each in range(100, second + 1)])
        for topic, message in (("/path", path), ("/pose", pose(second)), ("/points", cloud)):
            writer.write(topics[topic], second * 10**9, store.serialize_cdr(message, kinds[topic]))

path, poses = PoseData.from_bag("drive", "/path"), PoseData.from_bag("drive", "/pose")
print("path:", path.times[[0, -1]], "s; its last pose at", path.position(path.times[-1])[0], "m, which the vehicle was at", poses.times[-1], "s")
assert np.allclose(path.times, np.arange(110, 130)) and np.allclose(path.positions[:, 0], [place(second) for second in range(100, 120)])
assert np.allclose(poses.times, np.arange(110, 120))

rows = PointCloudData.from_bag("drive", "/points").pointcloud(110.0).get_xyz()
print("rows of the cloud, as (ring, shot):", rows[..., :2].astype(int).tolist())
assert rows[..., :2].tolist() == [[[0, 0], [0, 1]], [[0, 2], [1, 0]], [[1, 1], [1, 2]]]

poses.clip(115, 117)
print("cut:", poses.times, "s; all_poses:", len(poses.all_poses()), "from", poses.all_poses()[0, 0, 3], "m on, where", place(115), "is right")
assert poses.times.tolist() == [115, 116] and poses.positions[:, 0].tolist() == [85, 100]
assert poses.all_poses()[:, 0, 3].tolist() == [place(second) for second in range(110, 120)]
PYTHON
