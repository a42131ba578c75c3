#!/usr/bin/env bash
# An OpenLABEL file has the pose of a vehicle in the map for every second frame, as poses come at half the rate of the lidar. The library of
# those who wrote the format brings a box of each frame into the map. Guess: between two poses it interpolates, takes the one before, or
# raises an error. Seen with vcd 6.0.3 on 2026-11-29: it takes the pose that the coordinate system was declared with, here the origin, without
# a word: a vehicle at 10 m/s that drives straight on is at 0, 0, 20, 0, 40, 0 m. `get_transform` says "static" of such a frame, beside the matrix.
# - `interpolate_pose` of its utilities, which does interpolate, takes matrices number by number: half-way through a turn by 90 degrees
#   the axes are 0.71 long; and it has no pose for the very time of the first one
# - a box comes out of `transform_cuboid` with Euler angles, 9 numbers, whatever it went in with: a quaternion has 10, and both are valid
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check vcd==6.0.3 numpy==2.2.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import numpy as np
from vcd import core, scl, types, utils


def matrix(x, degrees=0):
    cosine, sine = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[cosine, -sine, 0, x], [sine, cosine, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])


def numbers(pose):
    return {"val": pose.ravel().tolist(), "t_type": types.TransformDataType.matrix_4x4}


labels = core.OpenLABEL()
labels.add_coordinate_system("map", cs_type=types.CoordinateSystemType.scene_cs)
labels.add_coordinate_system(
    "vehicle",
    cs_type=types.CoordinateSystemType.local_cs,
    parent_name="map",
    pose_wrt_parent=types.PoseData(**numbers(matrix(0))),
)
for frame in (0, 2, 4):
    data = types.TransformData(**numbers(matrix(10.0 * frame)))
    labels.add_transform(frame, types.Transform(src_name="vehicle", dst_name="map", transform_src_to_dst=data))
labels.save("drive.json")

read = core.OpenLABEL()
read.load_from_file("drive.json")
scene = scl.Scene(read)
found = [scene.get_transform("vehicle", "map", frame) for frame in range(6)]
print("x of the vehicle:", [float(pose[0, 3]) for pose, _ in found], "static:", [static for _, static in found])
assert [float(pose[0, 3]) for pose, _ in found] == [0, 0, 20, 0, 40, 0]
assert [static for _, static in found] == [False, True] * 3

poses = {0: matrix(0), 10: matrix(0, 90)}
between = utils.interpolate_pose(poses, 5)
print("length of the x axis:", np.linalg.norm(between[:3, 0]).round(2), "at the first time:", utils.interpolate_pose(poses, 0))
assert np.isclose(np.linalg.norm(between[:3, 0]), np.sqrt(0.5))
assert utils.interpolate_pose(poses, 0) is None

turned = [0, 0, np.sin(0.5), np.cos(0.5)]
box = scene.transform_cuboid([1, 2, 3, *turned, 4, 2, 1.5], "vehicle", "map", 2)
print("box:", [round(float(number), 3) for number in box])
assert np.allclose(box, [21, 2, 3, 0, 0, 1, 4, 2, 1.5])
PYTHON
