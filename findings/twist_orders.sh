#!/usr/bin/env bash
# Six numbers of a vehicle: 1 m/s ahead and a quarter turn to the left per second, in the order of ROS (geometry_msgs/Twist, and the covariance of a pose):
# x, y, z, then the rotations. A second later it is on an arc, at (0.64, 0.64). Where do libraries put it that turn six numbers into a pose?
# Guess: there, as it is one formula (the exponential of SE(3)), or at another place if they have rotations first. Seen on 2026-11-29:
#   pin 4.1.0   there
#   gtsam 4.3.0, pytransform3d 3.17.0   rolled by 57 degrees, to the right and above, at (0, -0.72, 1.32): rotations come first
#   symforce 0.12.0   rolled likewise, at (0, 0, 1.57); and with rotations first at (1, 0), as its tangent space of a pose is not SE(3)'s: rotation
#                     and position are two things, and no arc joins them. Its `retract` moves along the axes of the world, gtsam's along the body's
# So the covariance of a pose, which is as long in all of them, means something else in each; and the seven numbers of a pose, too: x, y, z, qx, qy, qz,
# qw in pin; qx, qy, qz, qw, x, y, z in symforce and pycolmap 4.2.1; x, y, z, qw, qx, qy, qz in pytransform3d
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check --no-deps \
  gtsam==4.3.0 pytransform3d==3.17.0 symforce-sym==0.12.0 pycolmap==4.2.1 numpy==2.4.6 scipy==1.17.1
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check pin==4.1.0 numpy==2.4.6
"$folder/venv/bin/python" - <<'PYTHON'
import gtsam
import numpy as np
import pinocchio
import pycolmap
import pytransform3d.transformations as pt
import sym

TURN = np.pi / 2
ROS = np.array([1, 0, 0, 0, 0, TURN])
ROTATIONS_FIRST = np.array([0, 0, TURN, 1, 0, 0])
POSE = np.array([[0.0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]])  # a quarter turn, at (1, 2, 3)
Q = np.sqrt(0.5)

exponentials = {
    "pin": lambda six: pinocchio.exp6(six).homogeneous,
    "gtsam": lambda six: gtsam.Pose3.Expmap(six).matrix(),
    "pytransform3d": pt.transform_from_exponential_coordinates,
    "symforce": lambda six: sym.Pose3.from_tangent(six).to_homogenous_matrix(),
}
ros, swapped = ({name: exponential(six) for name, exponential in exponentials.items()} for six in (ROS, ROTATIONS_FIRST))
for name in exponentials:
    print(f"{name}: as ROS has them {ros[name][:3, 3].round(2)}, rotations first {swapped[name][:3, 3].round(2)}")
arc = [1 / TURN, 1 / TURN, 0]
assert np.allclose(ros["pin"][:3, 3], arc)
for name in ("gtsam", "pytransform3d"):
    assert np.allclose(swapped[name][:3, 3], arc) and np.allclose(ros[name][:3, 3], [0, -0.72, 1.32], atol=0.01)
assert np.allclose(swapped["symforce"][:3, 3], [1, 0, 0]) and np.allclose(ros["symforce"][:3, 3], [0, 0, TURN])
assert all(np.isclose(ros[name][1, 1], np.cos(1)) for name in ("gtsam", "pytransform3d", "symforce"))  # rolled by one radian

step = np.array([0, 0, 0, 1.0, 0, 0])
turned = sym.Pose3(sym.Rot3.from_rotation_matrix(POSE[:3, :3]), POSE[:3, 3])
assert np.allclose(turned.retract(step).t, [2, 2, 3]) and np.allclose(gtsam.Pose3(POSE).retract(step).translation(), [1, 3, 3])

position, turn_xyzw, turn_wxyz = [1, 2, 3], [0, 0, Q, Q], [Q, 0, 0, Q]
assert np.allclose(pinocchio.SE3ToXYZQUAT(pinocchio.SE3(POSE)), position + turn_xyzw)
assert np.allclose(turned.to_storage(), turn_xyzw + position)
assert np.allclose(pycolmap.Rigid3d(POSE[:3]).params, turn_xyzw + position)
assert np.allclose(pt.pq_from_transform(POSE), position + turn_wxyz)
PYTHON
