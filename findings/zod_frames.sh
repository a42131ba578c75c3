#!/usr/bin/env bash
# Zenseact Open Dataset: a box and the lidar point in its middle are brought from the lidar's frame into the camera's, both with methods of
# the devkit that take the calibration and the two frames. Guess: the point is still in the middle of the box.
# Seen with zod 0.8.0 on 2026-11-29: the box is, at 20 m ahead of the camera, and the point is 22 m above it and 3 m to its right, without a
# word. Extrinsics are poses in the ego frame; `Calibration.transform_points` multiplies that of the second sensor with that of the first,
# where its inverse is due. So all that is brought into the frame of a sensor is wrong, and only what is brought into `EGO` is right;
# `Box2D.get_3d_frustum` goes through it, too.
# And clouds of 3 and 1 points, joined with `LidarData.extend`, have 0.2 s for their core time, where the mean that it takes is 0.25 s.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check zod==0.8.0 dataclass-wizard==0.35.4 numpy==2.2.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import numpy as np
from pyquaternion import Quaternion
from zod.constants import EGO, Camera, Lidar
from zod.data_classes import Calibration, LidarData, Pose
from zod.data_classes.box import Box3D
from zod.data_classes.calibration import CameraCalibration, LidarCalibration

ego_SE3_lidar = np.array([[0.0, -1, 0, 1], [1, 0, 0, 0], [0, 0, 1, 2], [0, 0, 0, 1]])
ego_SE3_camera = np.array([[0.0, 0, 1, 2], [-1, 0, 0, 0], [0, -1, 0, 1], [0, 0, 0, 1]])
none = np.zeros(4)
camera = CameraCalibration(Pose(ego_SE3_camera), np.eye(3), none, none, np.array([100, 100]), np.array([120, 60]))
calibration = Calibration({Lidar.VELODYNE: LidarCalibration(Pose(ego_SE3_lidar))}, {Camera.FRONT: camera})

point_ego = np.array([22.0, 0.5, 1.0])
point_lidar = (np.linalg.inv(ego_SE3_lidar) @ [*point_ego, 1])[:3]
point_camera = (np.linalg.inv(ego_SE3_camera) @ [*point_ego, 1])[:3]


def moved(point, source, target):
    return calibration.transform_points(point[None], source, target)[0]


box = Box3D(point_lidar.copy(), np.array([4.0, 2.0, 1.5]), Quaternion(), Lidar.VELODYNE)
box.convert_to(Camera.FRONT, calibration)
seen = moved(point_lidar, Lidar.VELODYNE, Camera.FRONT)
print("box in the camera's frame:", box.center.round(3), "point:", seen.round(3))
assert np.allclose(box.center, point_camera)
assert np.allclose(seen, (ego_SE3_camera @ ego_SE3_lidar @ [*point_lidar, 1])[:3])
assert np.linalg.norm(seen - box.center) > 20
assert np.allclose(moved(point_lidar, Lidar.VELODYNE, EGO), point_ego)
assert np.allclose(moved(point_ego, EGO, Camera.FRONT), (ego_SE3_camera @ [*point_ego, 1])[:3])
assert not np.allclose(moved(point_ego, EGO, Camera.FRONT), point_camera)


def cloud(points, time_s):
    bytes_ = np.zeros(points, np.uint8)
    return LidarData(np.zeros((points, 3)), np.full(points, time_s), bytes_, bytes_, time_s)


joined = cloud(3, 0.0)
joined.extend(cloud(1, 1.0))
print("core time of both:", joined.core_timestamp, "mean of the points:", joined.timestamps.mean())
assert np.isclose(joined.core_timestamp, 0.2)
assert np.isclose(joined.timestamps.mean(), 0.25)
PYTHON
