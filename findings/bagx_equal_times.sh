#!/usr/bin/env bash
# In a recording the camera's messages come 2 ms after those of an IMU that sends 100 times a second, for 10 s. Two of the IMU's 1000 messages have the same log time, as those of a
# driver that sends by twos have, or those of a simulation. bagx says how far apart the topics are (`bagx sync`, `bagx eval`): for each message the nearest of the other topic.
# Guess: 2 ms, with the two messages as without, whichever topic is named first.
# Seen with bagx 0.6.0 on 2026-11-30, without a word: 2 ms without; with them a mean of 4467 ms, and up to 9402. The nearest is sought step by step, while the next one is nearer; two
# at one time are equally near, so there it stands, up to the end of the recording. The IMU named first: 25 ms, both ways. And the score of `eval` falls from 100 to 0
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check bagx==0.6.0 rosbags==0.11.9 mcap==1.6.0 mcap-ros2-support==0.6.0 numpy==2.4.6
venv/bin/python - <<'PYTHON'
from pathlib import Path

import numpy as np
from bagx.eval import evaluate_bag
from bagx.sync import analyze_sync
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

START_NS, MS = 1_700_000_000_000_000_000, 1_000_000
CAMERA, IMU = "/camera/image/compressed", "/imu"
store = get_typestore(Stores.ROS2_HUMBLE)
types = store.types


def messages(time_ns):
    """Return a picture and a reading of that time."""
    stamp = types["builtin_interfaces/msg/Time"](sec=time_ns // 10**9, nanosec=time_ns % 10**9)
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="body")
    vector = types["geometry_msgs/msg/Vector3"]
    level = types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0)
    none = np.zeros(9)
    picture = types["sensor_msgs/msg/CompressedImage"](header=header, format="jpeg", data=np.zeros(8, np.uint8))
    return picture, types["sensor_msgs/msg/Imu"](header, level, none, vector(0.0, 0.0, 0.1), none, vector(0.0, 0.0, 9.81), none)


def write(name, twice_ms):
    """Write the recording, with the IMU's readings at these times, in ms from its start, twice."""
    events = [(START_NS + 100 * MS * number + 2 * MS, 0) for number in range(100)]
    events += [(START_NS + 10 * MS * number, 1) for number in range(1000)] + [(START_NS + time * MS, 1) for time in twice_ms]
    with Writer(Path(name), version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        kinds = ("sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/Imu")
        topics = [writer.add_connection(topic, kind, typestore=store) for topic, kind in zip((CAMERA, IMU), kinds)]
        for time_ns, which in sorted(events):
            writer.write(topics[which], time_ns, store.serialize_cdr(messages(time_ns)[which], kinds[which]))


found = {}
for name, twice_ms in (("all different", ()), ("two alike", (500,))):
    bag = name.replace(" ", "_")
    write(bag, twice_ms)
    (camera,), (imu,) = (analyze_sync(bag, *pair).pairs for pair in ((CAMERA, IMU), (IMU, CAMERA)))
    found[name] = [camera.mean_delay_ms, camera.max_delay_ms, imu.mean_delay_ms, evaluate_bag(bag).sync.score]
    print(f"{name}: mean {camera.mean_delay_ms:.0f} ms, up to {camera.max_delay_ms:.0f}; the IMU first {imu.mean_delay_ms:.0f} ms; score {found[name][3]}")
assert np.allclose(found["all different"], [2, 2, 25.2, 100], atol=0.1)
assert np.allclose(found["two alike"], [4467, 9402, 25.2, 0], atol=0.1)
PYTHON
