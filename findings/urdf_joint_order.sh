#!/usr/bin/env bash
# An arm with two fingers, and a camera that pans. The recorded positions of its joints become a vector. In which order does a library of
# robot kinematics have the joints of a URDF? Guess: as they stand in the file, or from the base outwards.
# Seen with pin (Pinocchio) 4.1.0, yourdfpy 0.0.60, urchin 0.0.30 and mujoco 4.0.0 on 2026-11-29: five joints, four orders
#   yourdfpy   as in the file: shoulder, elbow, camera, right finger, left finger
#   mujoco     along each branch, branches as in the file: shoulder, elbow, right finger, left finger, camera
#   urchin     by the number of joints from the base: shoulder, camera, elbow, right finger, left finger
#   pin        along each branch, branches by the ALPHABET of their joints: camera, shoulder, elbow, left finger, right finger
# A vector has the length that each of them wants, so where one library wrote it and another reads it, an angle of the arm turns the camera,
# and left and right are exchanged. For pin the camera would be the last if its joint were named `tilt`.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check pin==4.1.0 yourdfpy==0.0.60 urchin==0.0.30 mujoco==4.0.0 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
from pathlib import Path

import mujoco
import pinocchio
import urchin
import yourdfpy


def joint(name, parent, child, kind="revolute"):
    """Return a joint with the link that it moves."""
    inertia = '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
    return (
        f'<link name="{child}"><inertial><mass value="1"/>{inertia}</inertial></link><joint name="{name}" type="{kind}"><axis xyz="0 0 1"/>'
        f'<parent link="{parent}"/><child link="{child}"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint>'
    )


joints = [
    joint("shoulder", "base", "upper_arm"),
    joint("elbow", "upper_arm", "forearm"),
    joint("camera_pan", "base", "camera"),
    joint("right_finger", "forearm", "right_tip", "prismatic"),
    joint("left_finger", "forearm", "left_tip", "prismatic"),
]


def orders(text):
    """Return the names of the joints as each library has them."""
    Path("arm.urdf").write_text(text)
    model = mujoco.MjModel.from_xml_string(text)
    return {
        "yourdfpy": list(yourdfpy.URDF.load("arm.urdf", load_meshes=False).actuated_joint_names),
        "mujoco": [model.joint(number).name for number in range(model.njnt)],
        "urchin": [one.name for one in urchin.URDF.load("arm.urdf").actuated_joints],
        "pin": list(pinocchio.buildModelFromUrdf("arm.urdf").names)[1:],  # without the universe
    }


text = f'<robot name="arm"><link name="base"/>{"".join(joints)}</robot>'
seen, renamed = orders(text), orders(text.replace("camera_pan", "tilt"))
for name, order in seen.items():
    print(f"{name}: {', '.join(order)}")
assert seen["yourdfpy"] == ["shoulder", "elbow", "camera_pan", "right_finger", "left_finger"]
assert seen["mujoco"] == ["shoulder", "elbow", "right_finger", "left_finger", "camera_pan"]
assert seen["urchin"] == ["shoulder", "camera_pan", "elbow", "right_finger", "left_finger"]
assert seen["pin"] == ["camera_pan", "shoulder", "elbow", "left_finger", "right_finger"]
assert renamed["pin"] == ["shoulder", "elbow", "left_finger", "right_finger", "tilt"]
PYTHON
