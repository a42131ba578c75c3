#!/usr/bin/env bash
# A depth image, 0.5, 1.5, 3.5 and 8 m, and its red colour image become a cloud with Open3D, as in its examples: `RGBDImage.create_from_color_and_depth`, then
# `PointCloud.create_from_rgbd_image`. The depth is in millimetres as uint16, or in metres as float32, the two encodings that ROS has (REP 118).
# Guess: four red points at these depths, in both cases, as the type says which of both it is. Seen with open3d-cpu 0.20.0 on 2026-11-29, without a word:
# - two points are left: what is farther than 3 m is 0 in the image of the pair (`depth_trunc=3.0`); the newer function of `open3d.t` likewise (`depth_max=3.0`).
#   `PointCloud.create_from_depth_image`, of the same depth image without colours, has all four
# - of the image in metres all four are there, at 0.5, 1.5, 3.5 and 8 MILLIMETRES: floats are divided by 1000 as well, by all three
# - they are grey, 0.23: colours become an intensity unless `convert_rgb_to_intensity=False`
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check open3d-cpu==0.20.0 numpy==2.4.6
"$folder/venv/bin/python" - <<'PYTHON'
import numpy as np
import open3d

DEPTH_M = np.array([[0.5, 1.5, 3.5, 8.0]], dtype=np.float32)
INTRINSICS = open3d.camera.PinholeCameraIntrinsic(4, 1, 1.0, 1.0, 0.0, 0.0)
RED = np.zeros((1, 4, 3), dtype=np.uint8) + np.array([200, 0, 0], dtype=np.uint8)

for name, depth, unit_m in (("uint16, mm", (1000 * DEPTH_M).astype(np.uint16), 1), ("float32, m", DEPTH_M, 0.001)):
    cloud = open3d.geometry.PointCloud
    pair = open3d.geometry.RGBDImage.create_from_color_and_depth(open3d.geometry.Image(RED), open3d.geometry.Image(depth))
    coloured = cloud.create_from_rgbd_image(pair, INTRINSICS)
    tensor = open3d.t.geometry.PointCloud.create_from_depth_image(open3d.t.geometry.Image(depth), open3d.core.Tensor(np.eye(3)))
    seen_m = {
        "colour and depth": np.asarray(coloured.points)[:, 2],
        "open3d.t": tensor.point.positions.numpy()[:, 2],
        "depth alone": np.asarray(cloud.create_from_depth_image(open3d.geometry.Image(depth), INTRINSICS).points)[:, 2],
    }
    for way, depths_m in seen_m.items():
        print(f"{name}, {way}: {depths_m.round(4).tolist()} m")
        near = DEPTH_M[0] * unit_m
        assert np.allclose(depths_m, near if way == "depth alone" else near[near < 3])
    assert np.allclose(np.asarray(coloured.colors), 0.2345, atol=1e-3)
wanted = open3d.geometry.RGBDImage.create_from_color_and_depth(
    open3d.geometry.Image(RED), open3d.geometry.Image(DEPTH_M), depth_scale=1.0, depth_trunc=100.0, convert_rgb_to_intensity=False
)
cloud = open3d.geometry.PointCloud.create_from_rgbd_image(wanted, INTRINSICS)
assert np.allclose(np.asarray(cloud.points)[:, 2], DEPTH_M) and np.allclose(np.asarray(cloud.colors), [200 / 255, 0, 0])
PYTHON
