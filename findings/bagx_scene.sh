#!/usr/bin/env bash
# A robot drives along x at 1 m/s for 30 s. /tf says ten times a second where its base is in the frame odom; between these, in messages of three, where its wheels are on the base, as
# robot_state_publisher sends joints; and on /fix is where it is on the Earth. bagx makes a table of it (`bagx scene`: "Extract 3D state (position, orientation, velocity) time series").
# Guess: the way of the base; or all transforms, each with the names of its frames. Seen with bagx 0.6.0 on 2026-11-30, without a word: one series with 150 m of way in y, where the robot
# never was: of each message the FIRST transform, whichever frames it joins, so by turns the base in odom and the left wheel on the base; the other wheels are nowhere. There
# are no names of frames, in Python, JSON or CSV, whose one column `pos_x` has metres, and degrees of latitude in between (48.1)
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check bagx==0.6.0 rosbags==0.11.9 mcap==1.6.0 mcap-ros2-support==0.6.0 numpy==2.4.6
venv/bin/python - <<'PYTHON'
import csv
from pathlib import Path

import numpy as np
from bagx.scene import export_scene_csv, extract_scene
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

STEPS, START_NS, STEP_NS = 300, 1_700_000_000_000_000_000, 100_000_000
WHEELS = {"wheel_left": (0.0, 0.25, 0.0), "wheel_right": (0.0, -0.25, 0.0), "wheel_rear": (-0.5, 0.0, 0.0)}
store = get_typestore(Stores.ROS2_HUMBLE)
types = store.types


def header(time_ns, frame):
    stamp = types["builtin_interfaces/msg/Time"](sec=time_ns // 10**9, nanosec=time_ns % 10**9)
    return types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)


def transforms(time_ns, parent, children):
    level = types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0)
    found = []
    for child, place_m in children.items():
        transform = types["geometry_msgs/msg/Transform"](translation=types["geometry_msgs/msg/Vector3"](*place_m), rotation=level)
        found.append(types["geometry_msgs/msg/TransformStamped"](header=header(time_ns, parent), child_frame_id=child, transform=transform))
    return types["tf2_msgs/msg/TFMessage"](transforms=found)


def fix(time_ns, metres):
    status = types["sensor_msgs/msg/NavSatStatus"](status=0, service=1)
    place = {"latitude": 48.1, "longitude": 11.5 + metres / 74_000, "altitude": 560.0}
    return types["sensor_msgs/msg/NavSatFix"](header=header(time_ns, "gps"), status=status, **place, position_covariance=np.zeros(9), position_covariance_type=0)


with Writer(Path("drive"), version=9, storage_plugin=StoragePlugin.MCAP) as writer:
    topics = {kind: writer.add_connection(topic, kind, typestore=store) for topic, kind in (("/tf", "tf2_msgs/msg/TFMessage"), ("/fix", "sensor_msgs/msg/NavSatFix"))}
    for step in range(STEPS):
        time_ns, metres = START_NS + step * STEP_NS, step * 0.1
        said = [transforms(time_ns, "odom", {"base": (metres, 0.0, 0.0)}), transforms(time_ns, "base", WHEELS)] + [fix(time_ns, metres)] * (step % 10 == 0)
        for late, message in enumerate(said):
            writer.write(topics[message.__msgtype__], time_ns + late * STEP_NS // 4, store.serialize_cdr(message, message.__msgtype__))

scene = extract_scene("drive")
export_scene_csv(scene, Path("scene.csv"))
with open("scene.csv") as file:
    rows = list(csv.DictReader(file))
places_m = np.array([state.position for state in scene.states if state.source_topic == "/tf"])
print(f"{len(rows)} rows, {scene.sources}; columns {list(rows[0])}")
print(f"way along y {np.abs(np.diff(places_m[:, 1])).sum():.2f} m; the first four rows: {[row['pos_x'] for row in rows[:4]]}, {[row['pos_y'] for row in rows[:4]]}")
assert scene.sources == {"/tf": 2 * STEPS, "/fix": STEPS // 10} and not any("frame" in column for column in rows[0])
assert np.allclose(places_m[::2, 0], np.arange(STEPS) * 0.1) and (places_m[1::2] == WHEELS["wheel_left"]).all()
assert np.isclose(np.abs(np.diff(places_m[:, 1])).sum(), (2 * STEPS - 1) * 0.25)
assert {row["pos_x"] for row in rows if row["source"] == "/fix"} == {"48.1"}
PYTHON
