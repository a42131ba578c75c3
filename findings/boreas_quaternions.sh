#!/usr/bin/env bash
# Ground truth of the Boreas dataset has roll, pitch and heading for each pose. Its devkit makes a rotation matrix of them, and a quaternion of the matrix, for ROS or
# for a trajectory in the format of TUM. A vehicle is turned to the left by 0.5 rad, pitched by 0.2, rolled by 0.3. Are these the numbers that ROS has?
# Guess: yes: q = (x, y, z, w), as its docstring says, and yaw, pitch and roll of the matrix.
# Seen with asrl-pyboreas 2.0.0 on 2026-11-29, without a word: all of them are those of the INVERSE rotation.
# - `rotToQuaternion` of the matrix has x, y and z with the other sign, and `quaternionToRot` of ROS' quaternion is the matrix transposed
# - `yawPitchRollToRot(0.5, 0.2, 0.3)` is the transposed matrix; `rotToYawPitchRoll` of the vehicle's says -0.44, -0.31, -0.18
# - `get_transform3(x, y, theta)` turns to the right by theta; a twist turns to the left (`se3ToSE3`), in the same module
# There and back all of it fits together, so that nothing shows before a pose leaves the devkit.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check asrl-pyboreas==2.0.0 numpy==1.26.4 scipy==1.17.1
cd "$folder"
venv/bin/python - <<'PYTHON'
import numpy as np
from pyboreas.utils import utils
from scipy.spatial.transform import Rotation

map_R_vehicle = Rotation.from_euler("ZYX", [0.5, 0.2, 0.3])  # as ROS has yaw, pitch and roll
matrix = map_R_vehicle.as_matrix()
xyzw = utils.rotToQuaternion(matrix).ravel()
print(f"quaternion: {xyzw.round(3)}, that of ROS {map_R_vehicle.as_quat().round(3)}")
assert np.allclose(xyzw, map_R_vehicle.as_quat() * [-1, -1, -1, 1])
assert np.allclose(utils.quaternionToRot(map_R_vehicle.as_quat()), matrix.T)
assert np.allclose(utils.quaternionToRot(xyzw), matrix)

angles = np.array(utils.rotToYawPitchRoll(matrix))
print(f"yaw, pitch, roll: {angles.round(2)}")
assert np.allclose(utils.yawPitchRollToRot(0.5, 0.2, 0.3), matrix.T)
assert np.allclose(angles, [-0.44, -0.31, -0.18], atol=0.01)
assert np.allclose(utils.yawPitchRollToRot(*angles), matrix)

ahead = np.array([1.0, 0, 0])
by_angle = utils.get_transform3(0.0, 0.0, 0.5)[:3, :3] @ ahead
by_twist = utils.se3ToSE3(np.array([[0, 0, 0, 0, 0, 0.5]]).T)[:3, :3] @ ahead
print(f"turned by 0.5: y = {by_angle[1]:.2f} by get_transform3, {by_twist[1]:.2f} by se3ToSE3")
assert np.allclose([by_angle[1], by_twist[1]], [-np.sin(0.5), np.sin(0.5)])
PYTHON
