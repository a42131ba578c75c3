#!/usr/bin/env bash
# How many hours were recorded? `drives` has a folder for each day and a recording of ROS 1 beside them: monday/yard and tuesday/yard of ROS 2, monday/field.bag, town.bag, each
# of 10 s. rosbag-tools adds them up (`rosbag-tools compute-duration drives --total`: "the duration of every rosbag in a folder").
# Guess: 40 s. Seen with rosbag-tools 0.0.10 and the rosbags that it pins on 2026-11-30, without a word: 20 s. "Extracting durations from 3 rosbags" looks for ROS 2 at any depth, and for
# .bag only beside the days; and durations are kept by the name of a recording, without its folder, so that of two with one name, as a fixed route of each day has, one is in the sum
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check rosbag-tools==0.0.10 rosbags==0.9.16 numpy==2.4.6
venv/bin/python - <<'PYTHON'
import subprocess
from pathlib import Path

from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import Writer as Writer2
from rosbags.serde import serialize_cdr, serialize_ros1
from rosbags.typesys.types import std_msgs__msg__Bool as Bool

SECONDS, START_NS, TYPE = 10, 1_700_000_000_000_000_000, "std_msgs/msg/Bool"


def write(name, Writer, serialize, **options):
    """Write a recording with a message at its begin and one at its end."""
    path = Path("drives", name)
    path.parent.mkdir(parents=True, exist_ok=True)
    with Writer(path, **options) as writer:
        topic = writer.add_connection("/run", TYPE)
        for second in (0, SECONDS):
            writer.write(topic, START_NS + second * 10**9, serialize(Bool(data=True), TYPE))


def asked(*options):
    return subprocess.run(["venv/bin/rosbag-tools", "compute-duration", "drives", *options], check=True, capture_output=True, text=True).stdout


write("monday/yard", Writer2, serialize_cdr)
write("tuesday/yard", Writer2, serialize_cdr)
write("town.bag", Writer1, serialize_ros1)
write("monday/field.bag", Writer1, serialize_ros1)
each, total = asked(), asked("--total")
print(each, total)
assert "3 rosbags" in each and each.splitlines()[1:4] == ["Total duration: 00:00:20", "town: 00:00:10", "yard: 00:00:10"]
assert total.splitlines()[-1] == "00:00:20"
PYTHON
