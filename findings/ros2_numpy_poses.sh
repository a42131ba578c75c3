#!/usr/bin/env bash
# The mount of a lidar is a metre ahead, a quarter turn to the left (geometry_msgs/Transform); its cloud has x, y, z and intensity as float32, as most
# drivers publish them. Both become arrays with `ros2_numpy.numpify`, and are turned back with `msgify`.
# Guess: a 4 x 4 matrix of that turn, and the intensities; and messages that equal those given.
# Seen with ros2-numpy 0.0.5 beside transformations 2026.1.18 and sensor_msgs 5.3.6 on 2026-11-29, without a word:
# - the matrix turns by half a turn about an axis between y and z: the quaternion is x, y, z, w, and the library that makes the matrix, which
#   pip brings under a name like that of ROS' own, wants w, x, y, z
# - a Pose comes back as it was, by the same mistake twice; a Transform does not, as only one of its ways has the order right
# - the intensities 100, 100, 20 are 63, 64, 64: two bytes from the middle of x, as the NUMBER of the field (3) is taken for its offset (12)
# x, y, z are right where they come first; rings, times and all other fields are left out.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check ros-jazzy-sensor-msgs==5.3.6 ros-jazzy-nav-msgs==5.3.6 \
  ros-jazzy-geometry-msgs==5.3.6 numpy==1.26.4 transformations==2026.1.18 pybase64==1.5.1
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check --no-deps ros2-numpy==0.0.5 # it wants numpy 1.24.2
"$folder/venv/bin/python" - <<'PYTHON'
import numpy as np
import ros2_numpy
from geometry_msgs.msg import Pose, Quaternion, Transform
from sensor_msgs.msg import PointCloud2, PointField

HALF = np.sqrt(0.5)
QUARTER_TURN = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
INTENSITIES = [100.0, 100.0, 20.0]


def turn(quaternion):
    return [quaternion.x, quaternion.y, quaternion.z, quaternion.w]


mount = Transform(rotation=Quaternion(z=HALF, w=HALF))
mount.translation.x = 1.0
pose = Pose(orientation=mount.rotation)
matrices = {type(message).__name__: ros2_numpy.numpify(message) for message in (mount, pose)}
back = {"Transform": ros2_numpy.msgify(Transform, matrices["Transform"]).rotation, "Pose": ros2_numpy.msgify(Pose, matrices["Pose"]).orientation}
for name, matrix in matrices.items():
    print(f"{name}: {matrix[:3, :3].round(3).tolist()}, and back {np.round(turn(back[name]), 3).tolist()}")
    assert np.allclose(matrix[:3, :3], [[-1, 0, 0], [0, 0, 1], [0, 1, 0]])
assert np.allclose(np.abs(turn(back["Pose"])), np.abs(turn(mount.rotation)))
assert np.allclose(np.abs(turn(back["Transform"])), [0, HALF, HALF, 0])
right = np.eye(4)
right[:3, :3] = QUARTER_TURN
assert np.allclose(turn(ros2_numpy.msgify(Transform, right).rotation), [0, 0, HALF, HALF])
assert np.allclose(np.abs(turn(ros2_numpy.msgify(Pose, right).orientation)), [HALF, 0, 0, HALF])

names = ["x", "y", "z", "intensity"]
points = np.array([[1, 2, 3, INTENSITIES[0]], [4, 5, 6, INTENSITIES[1]], [7, 8, 9, INTENSITIES[2]]], np.float32)
cloud = PointCloud2(height=1, width=3, point_step=16, row_step=48, data=points.tobytes())
cloud.fields = [PointField(name=name, offset=4 * column, datatype=PointField.FLOAT32, count=1) for column, name in enumerate(names)]
arrays = ros2_numpy.numpify(cloud)
print(f"cloud: {arrays['xyz'].tolist()}, intensities {arrays['intensity'].ravel().tolist()}")
assert np.array_equal(arrays["xyz"], points[:, :3])
assert arrays["intensity"].ravel().tolist() == [63, 64, 64]
PYTHON
