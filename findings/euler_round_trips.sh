#!/usr/bin/env bash
# The rotation of an arm's hand is kept as roll, pitch and yaw, and made a matrix again: by four libraries for arms, for a hand that is held anyhow, and for one whose x axis
# points straight down, turned by 40 degrees about the vertical. Guess: the same matrix, as at 90 degrees of pitch only the sharing between roll and yaw is open.
# Seen on 2026-11-30, without a word, in degrees:                                          anyhow  straight down
#   robotics-numpy 0.1.0        r2rpy, rpy2r                                                    0    80: yaw has the other sign
#   robotics-numpy 0.1.0        r2eul, eul2r (ZYZ), its z axis down                             0   180
#   robot_kinematics 1.1.0      rotation_matrix_to_euler, euler_to_rotation_matrix, "xyz"       0    10
#   robot_kinematics 1.1.0      the same, "zyx"                                                71   180
#   qsp-orientation 0.1.1       quaternion_to_euler, euler_to_quaternion                        0    23
#   ManipulaPy 1.4.2            rotation_matrix_to_euler_angles, euler_to_rotation_matrix      35    95: the first gives radians, the second takes degrees
# `URDFKinematics` of robot_kinematics gives the identity as the pose of any arm's hand, at any angles: the chain of its joints is looked for from its base upwards
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check scipy==1.17.1 numpy==2.4.6 matplotlib==3.11.2 2>/dev/null
venv/bin/pip install --quiet --disable-pip-version-check --no-deps robotics-numpy==0.1.0 robot_kinematics==1.1.0 qsp-orientation==0.1.1 ManipulaPy==1.4.2 2>/dev/null
cat > trips.py <<'PYTHON'
import warnings

import numpy as np
import qsp.orientation as qsp
import robot_kinematics.core.transforms as kinematics
import robotics_numpy.transforms.rotations as rotations
from ManipulaPy.utils import so3
from robot_kinematics.forward.urdf_kinematics import URDFKinematics
from scipy.spatial.transform import Rotation

warnings.simplefilter("error")
ANYHOW = Rotation.from_euler("xyz", [10, 20, 30], degrees=True).as_matrix()
X_DOWN = Rotation.from_euler("xyz", [0, 90, 40], degrees=True).as_matrix()
Z_DOWN = Rotation.from_euler("z", 40, degrees=True).as_matrix() @ np.diag([1.0, -1, -1])
TRIPS = {
    "robotics-numpy": (X_DOWN, 0, 80, lambda m: rotations.rpy2r(*rotations.r2rpy(m))),
    "robotics-numpy, ZYZ": (Z_DOWN, 0, 180, lambda m: rotations.eul2r(*rotations.r2eul(m))),
    "robot_kinematics, xyz": (X_DOWN, 0, 10.255, lambda m: kinematics.euler_to_rotation_matrix(kinematics.rotation_matrix_to_euler(m))),
    "robot_kinematics, zyx": (X_DOWN, 71.093, 180, lambda m: kinematics.euler_to_rotation_matrix(kinematics.rotation_matrix_to_euler(m, "zyx"), "zyx")),
    "qsp-orientation": (
        X_DOWN, 0, 23.435,
        lambda m: qsp.quaternion_to_rotation_matrix(qsp.euler_to_quaternion(*qsp.quaternion_to_euler(qsp.rotation_matrix_to_quaternion(m)))),
    ),
    "ManipulaPy": (X_DOWN, 35.173, 95.093, lambda m: so3.euler_to_rotation_matrix(so3.rotation_matrix_to_euler_angles(m))),
}  # fmt: skip
for name, (down, *expected, trip) in TRIPS.items():
    off = [np.degrees(Rotation.from_matrix(matrix.T @ trip(matrix)).magnitude()) for matrix in (ANYHOW, down)]
    print(f"{name:24}{off[0]:8.3f}{off[1]:8.3f} degrees off")
    assert np.allclose(off, expected, atol=0.01)

with open("arm.urdf", "w") as file:
    file.write(
        '<robot name="arm"><link name="base"/><link name="hand"/><joint name="lift" type="revolute"><parent link="base"/><child link="hand"/>'
        '<origin xyz="0 0 0.3"/><axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="1" velocity="1"/></joint></robot>'
    )
pose = URDFKinematics("arm.urdf").forward_kinematics(np.array([0.5])).matrix
print("the hand, 0.3 m above the base and turned by 0.5 rad:", pose.tolist())
assert np.array_equal(pose, np.eye(4))
PYTHON
MANIPULAPY_QUIET=1 venv/bin/python trips.py 2> said.txt || { tail -5 said.txt; exit 1; }
if grep -i 'warn' said.txt; then exit 1; fi
