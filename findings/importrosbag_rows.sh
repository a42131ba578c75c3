#!/usr/bin/env bash
# A ROS 1 bag holds a pose and an IMU that are turned alike, 74 degrees about z, the mounts of three sensors on /tf_static, and a picture with
# padded rows. importRosbag reads it without ROS. What is in its arrays?
# Guess: quaternions in one order, that of ROS, and all that is in the bag. Seen with importRosbag 1.0.4 on 2026-11-29, without a word:
# - the pose's quaternion is (w, x, y, z), the IMU's (x, y, z, w): taken by one order, the IMU looks upside down
# - /tf_static is missing: transforms are read as tf/tfMessage, which ROS 1 left in 2013, and not as tf2_msgs/TFMessage
# - the second row of the picture, whose rows have 8 bytes for 2 pixels of 3, is shifted by those two bytes: `step` is not looked at
# - times are floats of seconds: 123456789 ns are .1234567
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check importrosbag==1.0.4 rosbags==0.11.9 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import numpy as np
from importRosbag.importRosbag import importRosbag
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

store = get_typestore(Stores.ROS1_NOETIC)
store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
kinds = {name.rpartition("/")[2]: kind for name, kind in store.types.items()}
Stamp, TIME_NS = store.types["builtin_interfaces/msg/Time"], 1_700_000_000_123_456_789

header = kinds["Header"](seq=0, stamp=Stamp(*divmod(TIME_NS, 10**9)), frame_id="map")
zero, none = kinds["Vector3"](0.0, 0.0, 0.0), np.zeros(9)
turn = kinds["Quaternion"](0.0, 0.0, 0.6, 0.8)
row = np.array([10, 20, 200, 10, 20, 200, 0, 0], "uint8")
mount = kinds["TransformStamped"](header, "lidar", kinds["Transform"](zero, turn))
messages = {
    "/pose": kinds["PoseStamped"](header, kinds["Pose"](kinds["Point"](0.0, 0.0, 0.0), turn)),
    "/imu": kinds["Imu"](header, turn, none, zero, none, zero, none),
    "/tf_static": kinds["TFMessage"]([mount] * 3),
    "/image": kinds["Image"](header, 2, 2, "bgr8", 0, 8, np.tile(row, 2)),
}
with Writer("drive.bag") as writer:
    for topic, message in messages.items():
        connection = writer.add_connection(topic, message.__msgtype__, typestore=store)
        writer.write(connection, TIME_NS, store.serialize_ros1(message, message.__msgtype__))

bag = importRosbag(filePathOrName="drive.bag")
pose, imu = bag["/pose"]["rotation"][0].tolist(), bag["/imu"]["rotQ"][0].tolist()
picture = np.asarray(bag["/image"]["frames"][0])
print(f"{sorted(bag)}; pose {pose}, IMU {imu}, {bag['/imu']['ts'][0]!r}; second row {picture[1].tolist()}")
assert pose == [0.8, 0, 0, 0.6] and imu == [0, 0, 0.6, 0.8]
assert "/tf_static" not in bag
assert picture[0].tolist() == [[10, 20, 200]] * 2 and picture[1].tolist() == [[0, 0, 10], [20, 200, 10]]
assert bag["/imu"]["ts"][0] == TIME_NS / 1e9
PYTHON
