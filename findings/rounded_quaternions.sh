#!/usr/bin/env bash
# The mount of a lidar is a quarter turn to the left, written by hand with two digits: x, y, z, w = 0, 0, 0.71, 0.71, of length 1.004. Where is a point that is
# 50 m ahead of the lidar? Guess: 50 m to the left, as every library divides by the length, or refuses. Seen on 2026-11-29, without a word:
#   scipy 1.17.1, pytransform3d 3.17.0                        50 m to the left
#   pin 4.1.0, gtsam 4.3.0, symforce 0.12.0, pycolmap 4.2.1   50.41 m to the left, and 0.41 m behind: the "rotation" stretches two of its axes
#   mujoco 4.0.0                                              50 m for a body in XML; by its function `mju_quat2Mat` 50.41 m, with all axes stretched, and by
#                                                             `mju_rotVecQuat` 50.41 m and 0.41 m behind
# The error grows with distance, as if calibration were off, and doubles on the way back: the transpose, by which rotations are inverted, stretches as well.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check --no-deps \
  gtsam==4.3.0 pytransform3d==3.17.0 symforce-sym==0.12.0 pycolmap==4.2.1 numpy==2.4.6 scipy==1.17.1
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check pin==4.1.0 mujoco==4.0.0 numpy==2.4.6
"$folder/venv/bin/python" - <<'PYTHON'
import gtsam
import mujoco
import numpy as np
import pinocchio
import pycolmap
import sym
from pytransform3d.rotations import matrix_from_quaternion
from scipy.spatial.transform import Rotation

XYZW, WXYZ = np.array([0, 0, 0.71, 0.71]), np.array([0.71, 0, 0, 0.71])
POINT_M = np.array([50.0, 0, 0])
BODY = f"<mujoco><worldbody><body quat='{' '.join(map(str, WXYZ))}'><geom size='1'/></body></worldbody></mujoco>"


def mujoco_body():
    model = mujoco.MjModel.from_xml_string(BODY)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return data.xmat[1].reshape(3, 3)


def mujoco_matrix():
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, WXYZ)
    return matrix.reshape(3, 3)


def mujoco_rotated():
    columns = np.empty((3, 3))
    for axis, column in zip(np.eye(3), columns):
        mujoco.mju_rotVecQuat(column, axis, WXYZ)
    return columns.T


rotations = {
    "scipy": Rotation.from_quat(XYZW).as_matrix(),
    "pytransform3d": matrix_from_quaternion(WXYZ),
    "mujoco, body": mujoco_body(),
    "pin": pinocchio.XYZQUATToSE3(np.array([0, 0, 0, *XYZW])).rotation,
    "gtsam": gtsam.Rot3.Quaternion(*WXYZ).matrix(),
    "symforce": sym.Rot3.from_storage(XYZW.tolist()).to_rotation_matrix(),
    "pycolmap": pycolmap.Rotation3d(XYZW).matrix(),
    "mujoco, mju_rotVecQuat": mujoco_rotated(),
    "mujoco, mju_quat2Mat": mujoco_matrix(),
}
for number, (name, rotation) in enumerate(rotations.items()):
    lengths, moved, back = np.linalg.norm(rotation, axis=0), rotation @ POINT_M, rotation.T @ rotation @ POINT_M
    print(f"{name}: {np.round(moved, 2).tolist()}, axes {np.round(lengths, 4).tolist()} long, and back {np.round(back, 2).tolist()}")
    if number < 3:
        assert np.allclose(moved, [0, 50, 0]) and np.allclose(lengths, 1)
    elif name == "mujoco, mju_quat2Mat":
        assert np.allclose(moved, [0, 50.41, 0]) and np.allclose(lengths, 1.0082)
    else:
        assert np.allclose(moved, [-0.41, 50.41, 0]) and np.allclose(lengths, [1.0082, 1.0082, 1], atol=1e-4) and back[0] > 50.8
PYTHON
