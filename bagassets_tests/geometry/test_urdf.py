"""Fixed joints of a URDF: frames, offsets, turns, and what is wrong where."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bagassets.base.errors import CalibrationError
from bagassets.geometry.euler import quaternions_from_rpy
from bagassets.geometry.se3 import SE3
from bagassets.geometry.tf_tree import TfTree
from bagassets.geometry.urdf import urdf_edges

angles = st.floats(-math.pi, math.pi)


def about(axis, angle):
    c, s = math.cos(angle), math.sin(angle)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[i, i], matrix[i, j], matrix[j, i], matrix[j, j] = c, -s, s, c
    return matrix


def robot(*joints, name="car", version=""):
    version = version and f' version="{version}"'
    return (
        f'<?xml version="1.0"?>\n<robot name="{name}"{version}>\n' + "\n".join(joints) + "\n</robot>\n"
    ).encode()


def joint(parent, child, origin='<origin xyz="1 2 3" rpy="0 0 0"/>', kind="fixed", name="j"):
    return (
        f'<joint name="{name}" type="{kind}">{origin}<parent link="{parent}"/><child link="{child}"/></joint>'
    )


@settings(deadline=None)
@given(angles, angles, angles)
def test_rpy_turns_about_the_fixed_axes_in_order(roll, pitch, yaw):
    matrix = about(2, yaw) @ about(1, pitch) @ about(0, roll)
    rotation = SE3.create(quaternions_from_rpy(np.array([roll, pitch, yaw])), (0, 0, 0)).rotation_matrix
    np.testing.assert_allclose(rotation, matrix, atol=1e-12)


def test_a_chain_of_joints():
    data = robot(
        '<link name="base"/>',
        joint("base", "/mast", '<origin xyz="1 0 2" rpy="0 0 1.5707963267948966"/>'),
        joint("mast", "cam", '<origin rpy="0 0.1 0" xyz=" 0.5  0 0 "/>'),
        joint("mast", "lidar", ""),
        joint("base", "wheel", kind="continuous"),
    )
    tree = TfTree(urdf_edges(data))
    assert "wheel" not in tree.frames
    base_SE3_cam, sources = tree.fixed("base", "cam")
    assert sources == ("urdf",)
    truth = about(2, math.pi / 2)
    np.testing.assert_allclose(base_SE3_cam.translation, truth @ [0.5, 0, 0] + [1, 0, 2], atol=1e-12)
    np.testing.assert_allclose(base_SE3_cam.rotation_matrix, truth @ about(1, 0.1), atol=1e-12)
    assert tree.fixed("mast", "lidar")[0] == SE3()


QUATERNION = '<origin xyz="1 2 3" quat_xyzw="0.5 -0.5 0.5 -0.5"/>'


@pytest.mark.parametrize("version", ["1.1", "1.2"])
def test_a_quaternion_turns_as_urdfdom_says(version):
    base_SE3_cam, _ = TfTree(urdf_edges(robot(joint("base", "cam", QUATERNION), version=version))).fixed(
        "base", "cam"
    )
    assert base_SE3_cam.translation == (1, 2, 3)
    # What Pinocchio 4.1.0 with urdfdom 6.0.0 makes of it (findings/urdf_quaternions.sh).
    np.testing.assert_allclose(base_SE3_cam.rotation_matrix, [[0, 0, 1], [-1, 0, 0], [0, -1, 0]], atol=1e-12)


@pytest.mark.parametrize(
    ("data", "problem"),
    [
        (b"<robot>\n<joint", "car.urdf, line 2: not XML"),
        (b"nothing", "car.urdf, line 1: not XML"),
        (b"<sdf/>", "car.urdf, line 1: a URDF starts with <robot>, this file with <sdf>"),
        (b'<!DOCTYPE r [<!ENTITY a "b">]><robot/>', r"document type \(<!DOCTYPE>\) is refused"),
        (robot(joint("base", "")), r'line 3: joint j has no <child link="…"/>'),
        (
            robot("", joint("a", "b", '<origin xyz="1 2"/>')),
            "line 4: joint j: xyz must be three numbers, it is '1 2'",
        ),
        (robot(joint("a", "b", '<origin rpy="0 0 nan"/>')), "joint j: rpy must be three numbers"),
        (robot(joint("a", "b", '<origin xyz="${x} 0 0"/>')), "expand it with xacro"),
        (robot(joint("a", "b", QUATERNION)), r'quat_xyzw needs <robot version="1.1"> or newer'),
        (robot(joint("a", "b", QUATERNION), version="1.0"), "quat_xyzw needs"),
        (
            robot(joint("a", "b", QUATERNION.replace("/>", ' rpy="0 0 0"/>')), version="1.2"),
            "and no rpy beside it",
        ),
        (
            robot(joint("a", "b", '<origin quat_xyzw="0 0 1"/>'), version="1.2"),
            "quat_xyzw must be four numbers",
        ),
        (robot(joint("a", "b", '<origin quat_xyzw="0 0 0 0"/>'), version="1.2"), "must be of unit length"),
    ],
)
def test_what_is_wrong_is_named_with_its_line(data, problem):
    with pytest.raises(CalibrationError, match=problem):
        urdf_edges(data, "car.urdf")


def test_other_elements_and_moving_joints_may_lack_what_they_like():
    data = robot('<joint name="x" type="revolute"/>', '<gazebo><joint type="fixed" name="deep"/></gazebo>')
    assert urdf_edges(data) == []
