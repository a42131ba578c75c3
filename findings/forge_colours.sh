#!/usr/bin/env bash
# A recording has two cameras, bgr8 as most drivers publish them, and joint states; from the fourth picture on, another node publishes these,
# which names joints b before a. It is read with forge, to become a LeRobot dataset. Guess: two cameras in RGB, joints in one order.
# Seen with forge-robotics 0.2.0 on 2026-11-29, without a word:
# - red is blue, whichever reader it takes: three channels are taken for RGB, and what `encoding` says decides on their number alone
# - joints are in the order of each message; names do not count: a and b change places within the episode
# - as a folder with its metadata.yaml, which its reader of bags takes, frames have ONE camera and no state at all, while `inspect` lists two
#   cameras and the joint states; as the .mcap within, which its reader of MCAP takes, they have all
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check forge-robotics==0.2.0 rosbags==0.11.9 mcap==1.6.0 mcap-ros2-support==0.6.0 \
  numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
from pathlib import Path

import numpy as np
from forge.formats.mcap.reader import MCAPReader
from forge.formats.rosbag.reader import RosbagReader
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)
HEIGHT, WIDTH, RED_BGR = 4, 6, (0, 0, 200)


def message(of, **fields):
    kind = f"{of.split('/')[0]}/msg/{of.split('/')[1]}"
    return STORE.types[kind](**fields)


with Writer(Path("drive"), version=9, storage_plugin=StoragePlugin.MCAP) as writer:

    def topic(name, kind):
        return writer.add_connection(name, kind, typestore=STORE)

    cameras = [topic(f"/{name}/image_raw", "sensor_msgs/msg/Image") for name in ("cam_left", "cam_right")]
    joints = topic("/joint_states", "sensor_msgs/msg/JointState")
    for number in range(5):
        time_ns = 1_700_000_000_000_000_000 + 100_000_000 * number
        stamp = message("builtin_interfaces/Time", sec=time_ns // 10**9, nanosec=time_ns % 10**9)
        header = message("std_msgs/Header", stamp=stamp, frame_id="camera")
        image = np.full((HEIGHT, WIDTH, 3), RED_BGR, np.uint8)
        fields = {"height": HEIGHT, "width": WIDTH, "encoding": "bgr8", "is_bigendian": 0, "step": 3 * WIDTH}
        image = message("sensor_msgs/Image", header=header, data=image.ravel(), **fields)
        names = ["a", "b"] if number < 3 else ["b", "a"]
        position, none = np.array([{"a": 1.0, "b": 2.0}[name] for name in names]), np.array([])
        state = message("sensor_msgs/JointState", header=header, name=names, position=position, velocity=none, effort=none)
        for connection in cameras:
            writer.write(connection, time_ns, STORE.serialize_cdr(image, connection.msgtype))
        writer.write(joints, time_ns, STORE.serialize_cdr(state, joints.msgtype))


def read(reader, path):
    """Return of each frame its state, and the colour of the first pixel of each camera."""
    (episode,) = reader.read_episodes(path)
    return [
        (
            None if frame.state is None else frame.state.tolist(),
            {name: tuple(image.load()[0, 0].tolist()) for name, image in frame.images.items()},
        )
        for frame in episode.frames()
    ]


(file,) = Path("drive").glob("*.mcap")
bag, mcap = read(RosbagReader(), Path("drive")), read(MCAPReader(), file)
inspected = RosbagReader().inspect(Path("drive"))
print("bag:", bag[0], "\nmcap:", mcap[0], mcap[-1], "\ninspected:", list(inspected.cameras), list(inspected.observation_schema))
assert list(inspected.cameras) == ["cam_left", "cam_right"]
assert list(inspected.observation_schema) == ["/joint_states"]
assert bag == [(None, {"cam_left": RED_BGR})] * 5
both = {"cam_left": RED_BGR, "cam_right": RED_BGR}
assert mcap == [([1.0, 2.0], both)] * 3 + [([2.0, 1.0], both)] * 2
PYTHON
