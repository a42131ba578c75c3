#!/usr/bin/env bash
# An arm's wrist camera (RealSense) sees a cup at 0.6 m, and has no depth (0) along its edge, as usual: 8 of the 121 pixels around a keypoint on the rim. airo-camera-toolkit places the keypoint,
# `unproject_using_depthmap`; and its cloud, of colours of 8 bits, goes to Open3D, to be filtered there, and comes back. Guess: 0.6 m; the colours as before.
# Seen with airo-camera-toolkit 2026.10.1 beside open3d-cpu 0.20.0 on 2026-11-30, without a word:
# - the keypoint is at 0 m, in the camera itself: of the depths around it the one is taken that 5 % are below, to keep to the cup and not the wall, and no depth is the least of all. 4 pixels do no harm, 8 do;
#   what its own RealSense returns has these zeros (`image * self.depth_factor`)
# - colours come back as floats of 0 to 1 where there were bytes: it makes floats of 64 bits of them, and turns floats of 32 bits back. As bytes all but a full channel are 0
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3.11 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check --no-deps airo-camera-toolkit==2026.10.1 airo-spatial-algebra==2026.10.1 airo-typing==2026.10.1 2>/dev/null
venv/bin/pip install --quiet --disable-pip-version-check open3d-cpu==0.20.0 spatialmath-python==1.1.18 numpy==2.4.6 scipy==1.17.1 2>/dev/null
cat > cup.py <<'PYTHON'
import numpy as np
from airo_camera_toolkit.pinhole_operations.unprojection import unproject_using_depthmap
from airo_camera_toolkit.point_clouds.conversions import open3d_to_point_cloud, point_cloud_to_open3d
from airo_typing import PointCloud

INTRINSICS = np.array([[600.0, 0, 320], [0, 600, 240], [0, 0, 1]])
for holes in (0, 4, 8):
    depth_m = np.full((480, 640), 0.6)
    depth_m[236, 316 : 316 + holes] = 0
    (place_m,) = unproject_using_depthmap(np.array([[320, 240]]), depth_m, INTRINSICS)
    print(f"{holes} pixels without depth: the keypoint is at {place_m} m")
    assert np.allclose(place_m, [0, 0, 0.6 if holes < 6 else 0])
cloud = PointCloud(np.zeros((2, 3), np.float32), np.array([[255, 128, 0], [10, 20, 30]], np.uint8))
back = open3d_to_point_cloud(point_cloud_to_open3d(cloud))
print("colours before:", cloud.colors.tolist(), "and after:", back.colors.dtype, back.colors.round(3).tolist(), "- as bytes:", back.colors.astype(np.uint8).tolist())
assert cloud.colors.dtype == np.uint8 and back.colors.dtype == np.float64 and np.allclose(back.colors, cloud.colors / 255)
assert back.colors.astype(np.uint8).tolist() == [[1, 0, 0], [0, 0, 0]]
PYTHON
venv/bin/python cup.py > said.txt 2>&1 || { tail -5 said.txt; exit 1; }
if grep -i warn said.txt; then exit 1; fi
cat said.txt
