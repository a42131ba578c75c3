#!/usr/bin/env bash
# How many bytes does `serialize_message` of rclpy make of joint states without velocities and efforts, which is what scripts write into
# bags with rosbag2_py? Guess: as many as the message has, or up to three more. Seen on 2026-11-28 with ROS 2 Jazzy (rclpy 7.1.6,
# rmw_fastrtps_cpp 8.4.3): eight more, of whatever was in memory. It takes for the length what was estimated beforehand, and the estimate
# aligns the items of an empty float64[], of which there are none. ROS 2 itself and mcap-ros2-support 0.6.0 do not look behind the
# message; rosbags 0.11.9 refuses it ("CDR message size mismatch"). With all three lists full it reads it.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check ros-jazzy-rclpy==7.1.6 ros-jazzy-sensor-msgs==5.3.6 \
  ros-jazzy-rmw-fastrtps-cpp==8.4.3 rosbags==0.11.9 mcap==1.6.0 mcap-ros2-support==0.6.0
cd "$folder"
venv/bin/python - <<'PYTHON'
import numpy as np
from mcap.writer import Writer
from mcap_ros2.reader import read_ros2_messages
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore
from sensor_msgs.msg import JointState

TYPE = "sensor_msgs/msg/JointState"
store = get_typestore(Stores.ROS2_JAZZY)
definition = store.generate_msgdef(TYPE, ros_version=2)[0].encode()


def by_mcap(data):
    with open("a.mcap", "wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2")
        channel = writer.register_channel("/joints", "cdr", writer.register_schema(TYPE, "ros2msg", definition))
        writer.add_message(channel, 0, data, 0)
        writer.finish()
    (one,) = read_ros2_messages("a.mcap")
    return list(one.ros_msg.position)


def by_rosbags(data):
    try:
        return store.deserialize_cdr(data, TYPE).position.tolist()
    except SerdeError as error:
        return str(error)


for fields, more in (({}, 8), ({"effort": [2.0]}, 8), ({"velocity": [0.5], "effort": [2.0]}, 0)):
    message = JointState(name=["elbow"], position=[1.5], **fields)
    data = bytes(serialize_message(message))
    own = store.types
    stamp = own["builtin_interfaces/msg/Time"](0, 0)
    lists = [np.array(getattr(message, name)) for name in ("position", "velocity", "effort")]
    least = len(store.serialize_cdr(own[TYPE](own["std_msgs/msg/Header"](stamp, ""), ["elbow"], *lists), TYPE))
    print(f"{fields}: {len(data)} bytes instead of {least}; rosbags: {by_rosbags(data)}; mcap: {by_mcap(data)}")
    assert deserialize_message(data, JointState) == message
    assert len(data) - least == more
    assert by_mcap(data) == [1.5]
    assert by_rosbags(data) == ([1.5] if more == 0 else f"CDR message size mismatch for {TYPE!r}.")
PYTHON
