"""Numbers in messages of ROS, protobuf and JSON, by the path of a field."""

import json
import math
from types import SimpleNamespace

import numpy as np
import pytest
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame

from bagassets.base.errors import DecodeError, UnsetError
from bagassets.decode.numeric_fields import numbers_at, own_stamp_ns
from bagassets.sample.arm import joint_state
from bagassets.sample.foxglove import FoxgloveRecorder
from bagassets.sample.messages import Messages
from bagassets_tests.recorded_bags import NOON_NS


def from_json(value):
    return json.loads(json.dumps(value), object_hook=lambda fields: SimpleNamespace(**fields))


def joint_states(**joints):
    """`foxglove.JointStates` as the sample writes it, with these fields of each joint."""
    message = joint_state(NOON_NS, tuple(joints), np.zeros(len(joints)), Messages(ros1=False))
    states = FoxgloveRecorder.converted("sensor_msgs/msg/JointState", message)
    for joint, fields in zip(states.joints, joints.values(), strict=True):
        joint.ClearField("position")
        for name, value in fields.items():
            setattr(joint, name, value)
    return states


def found(message, path):
    numbers = numbers_at(message, path)
    return numbers.labels, list(numbers.values), numbers.named


def test_joints_of_protobuf_that_have_no_such_value_are_left_out():
    states = joint_states(a={"position": 1.0, "velocity": 4.0}, b={"position": 0.0}, c={"velocity": 5.0})
    assert found(states, "joints.position") == (("a", "b"), [1.0, 0.0], True)
    assert found(states, "joints.velocity") == (("a", "c"), [4.0, 5.0], True)
    with pytest.raises(UnsetError, match=r"joints\.effort is empty"):
        numbers_at(states, "joints.effort")
    with pytest.raises(DecodeError, match=r"joints\.torque: torque is not one of name, position, velocity"):
        numbers_at(states, "joints.torque")
    with pytest.raises(UnsetError, match=r"joints\.position is empty"):
        numbers_at(joint_states(), "joints.position")
    assert own_stamp_ns(states) == NOON_NS


def test_protobuf_and_json_are_read_like_ros():
    pose = PoseInFrame()
    pose.timestamp.seconds, pose.timestamp.nanos = 5, 7
    pose.pose.position.x = 2.5
    assert found(pose, "pose.position") == (
        ("pose.position.x", "pose.position.y", "pose.position.z"),
        [2.5, 0, 0],
        False,
    )
    assert own_stamp_ns(pose) == 5_000_000_007
    message = from_json(
        {
            "stamp": {"sec": 3, "nsec": 4},
            "arm": {
                "names": ["b", "a"],
                "angles": [1, 2.5],
                "on": True,
                "text": "x",
                "grid": [[1, 2], [3, 4]],
            },
            "joints": [{"name": "x", "q": 1}, {"name": "y", "q": None}, {"name": "z", "q": 3}],
        }
    )
    assert found(message, "arm.angles") == (("b", "a"), [1.0, 2.5], True)
    assert found(message, "arm.on") == (("arm.on",), [1.0], False)
    assert found(message, "arm.angles[1]") == (("arm.angles[1]",), [2.5], False)
    assert found(message, "joints.q") == (("x", "z"), [1.0, 3.0], True)
    assert found(message, "joints[2].q") == (("joints[2].q",), [3.0], False)
    assert own_stamp_ns(message) == 3_000_000_004
    assert found(from_json({"n": 10**400}), "n") == (("n",), [math.inf], False)
    for path, error in (
        ("arm.text", "arm.text is not a number"),
        ("arm.on[0]", "is no array"),
        ("nothing", "there is no field nothing"),
    ):
        with pytest.raises(DecodeError, match=error):
            numbers_at(message, path)


def test_names_that_do_not_tell_elements_apart_are_no_names():
    for names in (["a", "a"], ["a", ""], ["a"]):
        message = from_json({"name": names, "position": [1, 2]})
        assert found(message, "position") == (("position[0]", "position[1]"), [1.0, 2.0], False)


def test_a_list_of_lists_is_refused():
    message = from_json({"grid": [[1, 2], [3, 4]], "ragged": [[1], [2, 3]]})
    for path in ("ragged", "grid"):
        with pytest.raises(DecodeError, match=path):
            numbers_at(message, path)
    labels, values, _ = found(message, "grid[1]")
    assert (labels, values) == (("grid[1][0]", "grid[1][1]"), [3.0, 4.0])
