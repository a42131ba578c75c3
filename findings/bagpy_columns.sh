#!/usr/bin/env bash
# An arm and its gripper publish their joints on one topic, /joint_states, by turns: three joints, then one. bagpy makes the CSV of the topic
# (`message_by_topic`), which is read with pandas. What is the gripper's effort?
# Guess: in a column of its own, or in the one for the first joint, with nothing where the arm has more joints.
# Seen with bagpy 0.5 and pandas 3.1.1 on 2026-11-29, without a word:
# - the columns are those of the FIRST message; every row is as long as its own lists. So the gripper's effort, 40 N, is in the column
#   `position_1`, and its `effort_0` is empty
# - if the gripper comes first, rows of the arm have more values than there are columns, and pandas refuses the file
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check bagpy==0.5 pandas==3.1.1 numpy==2.4.6 rosbags==0.11.9
cd "$folder"
venv/bin/python -W ignore - <<'PYTHON'
import numpy as np
import pandas as pd
from bagpy import bagreader
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore

store = get_typestore(Stores.ROS1_NOETIC)
Header, JointState, Time = (
    store.types[name] for name in ("std_msgs/msg/Header", "sensor_msgs/msg/JointState", "builtin_interfaces/msg/Time")
)
START_NS = 1_700_000_000_123_456_789
ARM = (["shoulder", "elbow", "wrist"], [0.1, 0.2, 0.3], [1.0, 2.0, 3.0])
GRIPPER = (["finger"], [0.05], [40.0])


def table(name, *joints):
    """Write a bag of these messages, and return the table that pandas reads of bagpy's CSV."""
    with Writer(f"{name}.bag") as writer:
        connection = writer.add_connection("/joint_states", JointState.__msgtype__, typestore=store)
        for number, (names, positions, efforts) in enumerate(joints):
            header = Header(seq=number, stamp=Time(sec=0, nanosec=0), frame_id="")
            message = JointState(header, names, np.array(positions), np.array([]), np.array(efforts))
            writer.write(connection, START_NS + number, store.serialize_ros1(message, message.__msgtype__))
    return pd.read_csv(bagreader(f"{name}.bag", verbose=False).message_by_topic("/joint_states"))


rows = table("arm_first", ARM, GRIPPER)
gripper = rows[[column for column in rows if column.startswith(("position", "effort"))]].iloc[1]
print(gripper.to_string())
assert gripper["position_0"] == 0.05 and gripper["position_1"] == 40.0
assert gripper[["position_2", "effort_0", "effort_1", "effort_2"]].isna().all()
try:
    refused = table("gripper_first", GRIPPER, ARM).to_string()
except pd.errors.ParserError as exc:
    refused = str(exc)
print(f"gripper first: {refused}")
assert refused.startswith("Error tokenizing data")
PYTHON
