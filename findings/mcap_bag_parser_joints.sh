#!/usr/bin/env bash
# An arm (joints a and b) and its gripper (grip) publish on one topic, /joint_states, by turns, as ros2_control and drivers of grippers do. The MCAP becomes a
# table with mcap-bag-parser, which has a column for each joint; then, with its cache (`use_pickle_if_exists`), the first second, and the next one.
# Guess: grip has a column, and is empty where the arm speaks; the second table begins where the first ends.
# Seen with mcap-bag-parser 0.3.1 on 2026-11-29, without a word:
# - columns are those of the FIRST message, and are filled by position: grip, 0.04, is in the column of a, every other row; b is empty there, and no column
#   is called grip. Where the gripper speaks first, columns are called 0 and 1, 0 is grip and a by turns, and no joint has a name
# - the second table is the first one: what is cached is found by the topics alone, whatever the window, and whatever became of the file
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check mcap-bag-parser==0.3.1 rosbags==0.11.9 pandas==3.1.1
cd "$folder"
venv/bin/python - >log <<'PYTHON'
from pathlib import Path

import numpy as np
from mcap_bag import BagFileParser
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

JOINTS, START_NS, PERIOD_NS = "sensor_msgs/msg/JointState", 1_700_000_000 * 10**9, 100_000_000
ARM, GRIPPER = (["a", "b"], [1.5, -0.5]), (["grip"], [0.04])

store = get_typestore(Stores.ROS2_HUMBLE)
time, header, joints = (store.types[name] for name in ("builtin_interfaces/msg/Time", "std_msgs/msg/Header", JOINTS))


def recorded(name, publishers):
    """Write 20 messages of two publishers by turns, and return the file."""
    with Writer(Path(name), version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        connection = bag.add_connection("/joint_states", JOINTS, typestore=store)
        for number in range(20):
            (names, positions), stamp_ns = publishers[number % 2], START_NS + number * PERIOD_NS
            message = joints(header(time(*divmod(stamp_ns, 10**9)), ""), names, np.array(positions), np.zeros(len(names)), np.zeros(len(names)))
            bag.write(connection, stamp_ns, store.serialize_cdr(message, JOINTS))
    return f"{name}/{name}.mcap"


def table(path, **options):
    return BagFileParser(path, use_pickle_if_exists=True).to_dataframe(["/joint_states"], **options)


arm_first, gripper_first = recorded("arm_first", [ARM, GRIPPER]), recorded("gripper_first", [GRIPPER, ARM])
first = table(arm_first, rel_start_time=0.0, rel_end_time=1.0)
second = table(arm_first, rel_start_time=1.0, rel_end_time=2.0)
other = table(gripper_first)
columns = [[name.removeprefix("/joint_states.") for name in each if ".position." in name] for each in (first, other)]
a, b = first["/joint_states.position.a"].to_list(), first["/joint_states.position.b"]
SEEN = f"""columns {columns}; a: {a[:4]}, b: {b.to_list()[:4]}
second table: from {(second["msg_timestamp"].iloc[0] - START_NS) / 1e9} s on"""
Path("seen").write_text(SEEN)
assert columns == [["position.a", "position.b"], ["position.0", "position.1"]]
assert a[:4] == [1.5, 0.04, 1.5, 0.04] and b.isna().tolist()[:4] == [False, True, False, True]
assert other["/joint_states.position.0"].to_list()[:4] == [0.04, 1.5, 0.04, 1.5]
assert second.equals(first) and second["msg_timestamp"].iloc[0] == START_NS
PYTHON
cat seen
