#!/usr/bin/env bash
# odin-robotics calls itself the standard library for robot learning data. Two episodes of five steps at 10 Hz, each from 0 s on, with a reward for each step, go to an MCAP (`to_mcap`) and back
# (`from_mcap`, with its marker of episodes); and a recording of ROS 2 (MCAP) with two joints at 10 Hz is read. Guess: two episodes of five steps with their rewards; two positions a step.
# Seen with odin-robotics 0.1.0 and mcap 1.6.0 on 2026-11-30, without a word:
# - three "episodes": eight steps of both by turns (1 of the first, 1 of the second, 2 of the first ...), as both have the same stamps; then the first step of each, alone, as a
#   time of 0 s counts as none and becomes the time of the conversion, 2026, fifty years after the rest. What is marked as the end of an episode, `done`, is seen once, not twice
# - rewards belong to the step before: a step is closed by its action, and its reward follows the action
# - the joints are 108 integers from 0 to 255: the bytes of the message. The decoder of ROS 2 is called by a method that it does not have, and what goes wrong is passed over
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check odin-robotics==0.1.0 mcap==1.6.0 mcap-ros2-support==0.6.0 rosbags==0.11.9 numpy==2.4.6
cd "$folder"
venv/bin/python -W ignore - <<'PYTHON'
from pathlib import Path

import numpy as np
from odin.convert.mcap import from_mcap, to_mcap
from odin.dataset import Dataset, Episode, Step
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore


def episode(number):
    """Return an episode whose joint, action and reward count from ten times its number."""
    values = [10.0 * number + step for step in range(5)]
    return Episode(steps=[
        Step(observation={"joint": np.array([value])}, action={"command": np.array([value])}, reward=value, done=step == 4, timestamp=step / 10)
        for step, value in enumerate(values)
    ])  # fmt: skip


to_mcap(Dataset(episodes=[episode(0), episode(1)]), "episodes.mcap", include_metadata=False)  # with it, mcap 1.6.0 refuses
read = from_mcap(
    "episodes.mcap", observation_topics=["/odin/observation/joint"], action_topics=["/odin/action/command"],
    reward_topic="/odin/reward", done_topic="/odin/done", episode_delimiter_topic="/odin/episode",
)  # fmt: skip
joints = [[float(step.observation["odin_observation_joint"][0]) for step in each.steps] for each in read.episodes]
rewards = [step.reward for step in read.episodes[0].steps]
times = [[step.timestamp for step in each.steps] for each in read.episodes]
print("joints:", joints, "\nrewards:", rewards, "\nfirst times:", [each[0] for each in times])
assert joints == [[1, 11, 2, 12, 3, 13, 4, 14], [0], [10]]
assert rewards == [0, 1, 11, 2, 12, 3, 13, 4]
assert times[0][0] == 0.1 and times[1][0] > 1.7e9 and times[2][0] > 1.7e9
assert sum(step.done for each in read.episodes for step in each.steps) == 1

store = get_typestore(Stores.ROS2_HUMBLE)
kind = "sensor_msgs/msg/JointState"
header, time = store.types["std_msgs/msg/Header"], store.types["builtin_interfaces/msg/Time"]
with Writer(Path("drive"), version=9, storage_plugin=StoragePlugin.MCAP) as writer:
    topic = writer.add_connection("/joint_states", kind, typestore=store)
    for number in range(5):
        message = store.types[kind](header(time(100, number * 10**8), ""), ["a", "b"], np.array([0.5, -0.5]), np.array([0.0, 0]), np.array([0.0, 0]))
        writer.write(topic, 100 * 10**9 + number * 10**8, store.serialize_cdr(message, kind))
steps = from_mcap(next(Path("drive").glob("*.mcap"))).episodes[0].steps
found = steps[0].observation["joint_states"]
print(len(steps), "steps; the first:", found.dtype, found.shape, found[:12])
assert len(steps) == 5 and found.dtype == np.uint8 and len(found) == 108
PYTHON
