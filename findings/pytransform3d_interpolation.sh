#!/usr/bin/env bash
# Two poses of a vehicle, a metre and a quarter turn apart, are put into pytransform3d's TemporalTransformManager, its counterpart of tf2.
# Where is the vehicle half-way? Guess: where tf2 and nuScenes tools put it, 0.5 m on the straight line, turned by 45 degrees on the
# shorter arc. Seen with pytransform3d 3.17.0 on 2026-11-28:
# - position and rotation are interpolated together, as a screw: it is 0.207 m beside the line
# - of quaternions whose sign flips from pose to pose, as localisation nodes publish them, the manager takes the shorter arc; but
#   `quaternion_slerp` and `quaternion_slerp_batch` of the same library go the long way round unless `shortest_path=True`: between 0 and
#   0.2 rad is -3.04 rad, as if it looked backwards. SciPy 1.17.1 and pyquaternion 0.9.9 take the shorter arc.
# - outside of the poses the manager refuses, as does SciPy's Slerp; RotationSpline of the same module goes on turning without end
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check pytransform3d==3.17.0 scipy==1.17.1 pyquaternion==0.9.9 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import numpy as np
from pyquaternion import Quaternion
from pytransform3d.batch_rotations import quaternion_slerp_batch
from pytransform3d.rotations import quaternion_slerp
from pytransform3d.transform_manager import NumpyTimeseriesTransform, TemporalTransformManager
from scipy.spatial.transform import Rotation, RotationSpline, Slerp


def about_z(angle):
    return np.array([np.cos(angle / 2), 0, 0, np.sin(angle / 2)])


def yaw(quaternion):
    w, x, y, z = quaternion
    return Rotation.from_quat([x, y, z, w]).as_euler("ZYX")[0]


def half_way(last):
    poses = np.array([[0, 0, 0, *about_z(0)], [1, 0, 0, *last]])
    manager = TemporalTransformManager()
    manager.add_transform("car", "map", NumpyTimeseriesTransform(np.array([0.0, 1.0]), poses))
    manager.current_time = np.array([0.5])
    matrix = manager.get_transform("car", "map")[0]
    manager.current_time = np.array([1.5])
    try:
        manager.get_transform("car", "map")
    except ValueError:
        return matrix
    raise SystemExit("outside of the poses is no longer refused")


matrix = half_way(about_z(np.pi / 2))
print(f"half-way: {matrix[:2, 3].round(3)} m, {np.degrees(Rotation.from_matrix(matrix[:3, :3]).magnitude()):.0f} degrees")
assert np.allclose(matrix[:2, 3], [0.5, -0.2071068])

start, flipped = about_z(0), -about_z(0.2)
flipped_matrix = half_way(flipped)
assert np.isclose(np.arctan2(flipped_matrix[1, 0], flipped_matrix[0, 0]), 0.1)
long = {
    "quaternion_slerp": yaw(quaternion_slerp(start, flipped, 0.5)),
    "quaternion_slerp_batch": yaw(quaternion_slerp_batch(start, flipped, np.array([0.5]))[0]),
}
short = {
    "shortest_path=True": yaw(quaternion_slerp(start, flipped, 0.5, shortest_path=True)),
    "pyquaternion": yaw(Quaternion.slerp(Quaternion(start), Quaternion(flipped), 0.5).elements),
    "scipy": Slerp([0, 1], Rotation.from_quat([[0, 0, 0, 1], np.roll(flipped, -1)]))(0.5).as_euler("ZYX")[0],
}
print(long, short)
assert np.allclose(list(long.values()), 0.1 - np.pi)
assert np.allclose(list(short.values()), 0.1)

turns = Rotation.from_euler("z", np.radians([[0], [10], [20], [30]]))
try:
    Slerp(range(4), turns)([6])
except ValueError as error:
    print("Slerp:", error)
else:
    raise SystemExit("Slerp no longer refuses")
beyond = RotationSpline(range(4), turns)([6]).as_euler("zyx", degrees=True)[0, 0]
print(f"RotationSpline at twice the time: {beyond:.1f} degrees")
assert np.isclose(beyond, 60)
PYTHON
