#!/usr/bin/env bash
# A scan becomes a range image with the scripts of SemanticKITTI (`LaserScan(project=True)`), as many networks for lidar do: 64 rows from 3 degrees above to
# 25 below the horizon. Five points: the first straight ahead, two at the left and right; a bridge 20 degrees above, at 15 m; the roof of the car, 40 degrees
# below, at 2 m; and, before the sensor had a return, zeros. Where are they? Guess: the first three in their pixels, the rest in none. Seen with
# semantic-kitti-api 0.1 on 2026-11-29, without a word: the bridge is in the top row, the roof in the bottom one, as if at the edge of the field of view,
# where they hide what is farther there; the zeros are a pixel straight ahead, of a range of 0. And the first point of a scan, whose number is 0, has its
# range but is marked as no measurement (`proj_mask`): one in each scan.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check numpy==2.4.6
"$folder/venv/bin/pip" download --quiet --disable-pip-version-check --no-deps --no-binary :all: --dest "$folder" semantic-kitti-api==0.1
cd "$folder"
tar -xzf semantic*api-0.1.tar.gz
PYTHONPATH=$(dirname "$(find . -name laserscan.py)") venv/bin/python - <<'PYTHON'
import numpy as np
from laserscan import LaserScan

ROWS, COLUMNS = 64, 1024


def point(range_m, azimuth_deg, elevation_deg):
    azimuth, elevation = np.radians([azimuth_deg, elevation_deg])
    return range_m * np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])


names = ["first", "left", "right", "bridge", "far, at the top", "roof", "zeros"]
points = np.array([point(30, 0.5, -5), point(20, 90, -5), point(20, -90, -5), point(15, 45, 20), point(60, 45, 2.9), point(2, 100, -40), np.zeros(3)])
scan = LaserScan(project=True, H=ROWS, W=COLUMNS, fov_up=3.0, fov_down=-25.0)
scan.set_points(points.astype(np.float32), np.ones(len(points), np.float32))
for name, row, column in zip(names, scan.proj_y, scan.proj_x):
    print(f"{name}: row {row}, range {scan.proj_range[row, column]:.1f} m, a measurement: {bool(scan.proj_mask[row, column])}")
pixels = dict(zip(names, zip(scan.proj_y.tolist(), scan.proj_x.tolist())))
assert pixels["bridge"] == pixels["far, at the top"] and pixels["bridge"][0] == 0 and np.isclose(scan.proj_range[pixels["bridge"]], 15)
assert pixels["roof"][0] == ROWS - 1 and scan.proj_mask[pixels["roof"]] == 1
assert scan.proj_range[pixels["zeros"]] == 0 and scan.proj_mask[pixels["zeros"]] == 1
assert np.isclose(scan.proj_range[pixels["first"]], 30) and scan.proj_mask[pixels["first"]] == 0
assert scan.proj_mask[pixels["left"]] == scan.proj_mask[pixels["right"]] == 1
PYTHON
