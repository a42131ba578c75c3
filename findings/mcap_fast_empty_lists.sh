#!/usr/bin/env bash
# A recording (MCAP, ROS 2) has boxes of vision_msgs/Detection3D: a detector that names no classes leaves `results` empty; the centre of the box follows. It is read with mcap-ros2-support-fast, "high-performance"
# and with mcap-ros2-support. Guess: the centre is at x = 20 m in both.
# Seen with mcap-ros2-support-fast 0.8.0 and mcap-ros2-support 0.6.0 on 2026-11-30, without a word:
# - of the former: x = 0, a length of 5e-315 m in place of 4 m and an id of six letters, in the frames "map", "base_link" or "velodyne"; all is right in "lidar" or "camera_front". The
#   length of an empty list is followed by padding only up to where the next number needs it; that decoder takes the next double to begin 4 bytes early if the items of
#   the list would have ended in doubles, and whether there is padding to miss depends on the letters of the frame's name
# - one result in the list, and all is right; so is each message of ROS 2 Jazzy's own packages, none of which has a double behind a list of such messages
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check mcap-ros2-support-fast==0.8.0 mcap-ros2-support==0.6.0 mcap==1.6.0 rosbags==0.11.9 numpy==2.4.6 2>/dev/null
cat > boxes.py <<'PYTHON'
from pathlib import Path

import mcap_ros2.decoder
import mcap_ros2_support_fast
import numpy as np
from mcap.reader import make_reader
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

DETECTION = "vision_msgs/msg/Detection3D"
DEFINITIONS = {
    "vision_msgs/msg/ObjectHypothesis": "string class_id\nfloat64 score",
    "vision_msgs/msg/ObjectHypothesisWithPose": "vision_msgs/ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose",
    "vision_msgs/msg/BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size",
    DETECTION: "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\nvision_msgs/BoundingBox3D bbox\nstring id",
}
STORE = get_typestore(Stores.ROS2_JAZZY)
STORE.register({name: fields for kind, text in DEFINITIONS.items() for name, fields in get_types_from_msg(text, kind).items()})


def of(name, *values):
    return STORE.types[name](*values)


def detection(frame, results):
    header = of("std_msgs/msg/Header", of("builtin_interfaces/msg/Time", 1_700_000_000, 0), frame)
    pose = of("geometry_msgs/msg/Pose", of("geometry_msgs/msg/Point", 20.0, 3.0, 1.0), of("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0))
    result = of("vision_msgs/msg/ObjectHypothesisWithPose", of("vision_msgs/msg/ObjectHypothesis", "car", 0.9), of("geometry_msgs/msg/PoseWithCovariance", pose, np.zeros(36)))
    return of(DETECTION, header, [result] * results, of("vision_msgs/msg/BoundingBox3D", pose, of("geometry_msgs/msg/Vector3", 4.0, 2.0, 1.5)), "7")


wrong = []
for frame in ("map", "lidar", "base_link", "velodyne", "camera_front"):
    for results in (0, 1):
        name = f"{frame}_{results}"
        with Writer(Path(name), version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            topic = writer.add_connection("/detections", DETECTION, typestore=STORE)
            writer.write(topic, 1_700_000_000 * 10**9, STORE.serialize_cdr(detection(frame, results), DETECTION))
        (path,) = Path(name).glob("*.mcap")
        found = []
        for factory in (mcap_ros2.decoder.DecoderFactory(), mcap_ros2_support_fast.DecoderFactory()):
            with path.open("rb") as file:
                ((_, _, _, message),) = make_reader(file, decoder_factories=[factory]).iter_decoded_messages()
                found.append((message.bbox.center.position.x, message.bbox.size.x, message.id))
        assert found[0] == (20, 4, "7")
        if found[1] != found[0]:
            wrong.append(name)
            print(f"frame {frame}, {results} results: x, length and id are {found[1]}")
            assert found[1][0] == 0 and 0 < found[1][1] < 1e-300 and len(found[1][2]) == 6
print("wrong:", wrong)
assert wrong == ["map_0", "base_link_0", "velodyne_0"]
PYTHON
venv/bin/python boxes.py > said.txt 2>&1 || { tail -5 said.txt; exit 1; }
if grep -i warn said.txt; then exit 1; fi
cat said.txt
