#!/usr/bin/env bash
# A bag has a car's odometry in `odom`, an obstacle 10 m ahead of its lidar and fixes of GNSS, and /tf with what each frame is in the other. bagsy brings them
# into `map` and `base_link`, for which its `stream_bag` has "a list of frames for which reprojections are needed". Guess: where tf2 puts them.
# Seen with bagsy 1.6.3 on 2026-11-30, without a word: each is moved by the INVERSE of its transform, whichever way round the frames are in /tf, and however
# many lie between. The obstacle 10 m ahead of a lidar that is 2 m ahead of the axle is 8 m ahead of the axle, not 12; a car that heads along the map's y axis
# heads the other way; and a fix at the origin of a map is 10,800 km off it. `frame_id` is the one asked for. What comes before the first transform is left
# out. `parse_bag`, which makes tables of the same, ends in `KeyError`. Without such frames, messages are well
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check bagsy==1.6.3 rosbags==0.11.9 \
  numpy==2.4.6 open3d==0.20.0 pandas==3.1.1 utm==0.9.0
cd "$folder"
venv/bin/python - <<'PYTHON'
from pathlib import Path

import numpy as np
import utm
from bagsy.lib.parse_bag import parse_bag, stream_bag
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_typestore

store = get_typestore(Stores.ROS2_HUMBLE)
kinds = store.types
STAMP = kinds["builtin_interfaces/msg/Time"](sec=1_750_000_000, nanosec=0)
LATITUDE, LONGITUDE = 48.71, 2.21
EAST, NORTH, *_ = utm.from_latlon(LATITUDE, LONGITUDE)


def header(frame):
    return kinds["std_msgs/msg/Header"](stamp=STAMP, frame_id=frame)


def quaternion(degrees):
    half = np.radians(degrees) / 2
    return kinds["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=float(np.sin(half)), w=float(np.cos(half)))


def point(x, y, z=0.0):
    return kinds["geometry_msgs/msg/Point"](x=float(x), y=float(y), z=float(z))


def transform(parent, child, x, y, degrees):
    vector = kinds["geometry_msgs/msg/Vector3"](x=float(x), y=float(y), z=0.0)
    moved = kinds["geometry_msgs/msg/Transform"](translation=vector, rotation=quaternion(degrees))
    return kinds["geometry_msgs/msg/TransformStamped"](header=header(parent), child_frame_id=child, transform=moved)


still = kinds["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0)
velocity = kinds["geometry_msgs/msg/Twist"](linear=still, angular=still)
twist = kinds["geometry_msgs/msg/TwistWithCovariance"](twist=velocity, covariance=np.zeros(36))
ahead = kinds["geometry_msgs/msg/Pose"](position=point(20, 0), orientation=quaternion(0))
pose = kinds["geometry_msgs/msg/PoseWithCovariance"](pose=ahead, covariance=np.zeros(36))
status = kinds["sensor_msgs/msg/NavSatStatus"](status=0, service=1)
fix = {"latitude": LATITUDE, "longitude": LONGITUDE, "altitude": 0.0, "position_covariance": np.zeros(9), "position_covariance_type": 0}
# The map lies at that fix; odometry began 100 m north in the map, heading along its y axis; the lidar is 2 m ahead of the axle, and looks ahead
tree = [transform("utm", "map", EAST, NORTH, 0), transform("map", "odom", 0, 100, 90)]
tree += [transform("odom", "base_link", 20, 0, 0), transform("base_link", "lidar", 2, 0, 0)]
messages = {
    "/tf": kinds["tf2_msgs/msg/TFMessage"](transforms=tree),
    "/odometry": kinds["nav_msgs/msg/Odometry"](header=header("odom"), child_frame_id="base_link", pose=pose, twist=twist),
    "/obstacle": kinds["geometry_msgs/msg/PointStamped"](header=header("lidar"), point=point(10, 0)),
    "/fix": kinds["sensor_msgs/msg/NavSatFix"](header=header("gnss"), status=status, **fix),
}
with Writer("drive", version=9) as bag:
    for number, (topic, message) in enumerate(messages.items()):
        connection = bag.add_connection(topic, message.__msgtype__, typestore=store)
        bag.write(connection, 1_750_000_000_000_000_000 + number, store.serialize_cdr(message, message.__msgtype__))

wanted = {"/odometry": ["map"], "/obstacle": ["base_link", "map"], "/fix": ["map"]}
rows = {topic: row for topic, _, row in stream_bag(Path("drive"), [], wanted, no_covariance=True, rpy=True)}
places = {"/odometry_in_map": "pose.pose.position.", "/obstacle_in_base_link": "point.", "/obstacle_in_map": "point.", "/fix_in_map": ""}
true = {"/odometry_in_map": (0, 120), "/obstacle_in_base_link": (12, 0), "/obstacle_in_map": (0, 132), "/fix_in_map": (0, 0)}
for topic, prefix in places.items():
    given = np.array([rows[topic][f"{prefix}{axis}"] for axis in "xy"])
    print(f"{topic}: {true[topic]} is {given.round(2)} m, said to be in {rows[topic]['header.frame_id']}")
    assert np.linalg.norm(given - true[topic]) > 3.9
heading = np.degrees(rows["/odometry_in_map"]["pose.pose.orientation.yaw"])
print(f"the heading of 90 degrees in the map is {heading:.0f}")
assert round(heading) == -90 and np.isclose(rows["/obstacle_in_base_link"]["point.x"], 8)
try:
    parse_bag(Path("drive"), [], wanted, Path("."), no_covariance=True, rpy=True)
except KeyError as error:
    print(f"parse_bag: KeyError {error}")
PYTHON
