#!/usr/bin/env bash
# A reconstruction by COLMAP: 60 pictures along a street, one a metre, each of the house 8 m to its left and the hills 300 m behind it. poselab, which cleans reconstructions for splats and
# NeRFs, keeps the points that are less than 20 m away from a camera that sees them (`filter_features_distance_camera`). Guess: all 60 points of houses are kept, none of hills.
# Seen with poselab 0.2.2 and pycolmap 4.2.1 on 2026-11-30, without a word: those of the first 10 houses. The translation of a pose, which takes points of the world to the camera, is taken
# for the place of the camera (pycolmap's `projection_center`), though it lies on the other side of the
# origin here: by it, camera 59 is 118 m from its house
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3.11 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check pycolmap==4.2.1 numpy==2.4.6 scipy==1.17.1 matplotlib==3.11.2 tqdm==4.70.1 colorama==0.4.6 vedo==2026.6.3 vtk==9.7.2 2>/dev/null
venv/bin/pip install --quiet --disable-pip-version-check --no-deps poselab==0.2.2 2>/dev/null
cat >distances.py <<'PYTHON'
from pathlib import Path

import numpy as np
import pycolmap
from poselab.filter import filter_features_distance_camera
from poselab.poseparser import read_model

PICTURES, LIMIT_M = 60, 20
world_from_camera = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # x right is x along the street, z ahead is y to its left, y down is -z
turned = pycolmap.Rotation3d(world_from_camera.T)
x, y, z, w = turned.quat
poses, points = [], []
for picture in range(PICTURES):
    centre_m = np.array([picture, 0.0, 0.0])
    tx, ty, tz = -world_from_camera.T @ centre_m
    seen = []
    for index, (place_m, kind) in enumerate((((picture, 8.0, 0.0), 1), ((picture, 300.0, 0.0), 2))):
        point_id = 2 * picture + kind
        points.append(f"{point_id} {place_m[0]} {place_m[1]} {place_m[2]} 128 128 128 0.5 {picture + 1} {index}")
        seen.append(f"320 240 {point_id}")
    poses.append(f"{picture + 1} {w} {x} {y} {z} {tx} {ty} {tz} 1 {picture:03}.png\n{' '.join(seen)}")
for name, lines in (("cameras", ["1 PINHOLE 640 480 500 500 320 240"]), ("images", poses), ("points3D", points)):
    Path("street").mkdir(exist_ok=True)
    Path("street", f"{name}.txt").write_text("\n".join(lines) + "\n")

street = pycolmap.Reconstruction("street")
distances_m = {point_id: np.linalg.norm(street.images[point.track.elements[0].image_id].projection_center() - point.xyz) for point_id, point in street.points3D.items()}
filter_features_distance_camera("street", "filtered", LIMIT_M)
kept = sorted(read_model("filtered")[2])
near = sorted(point_id for point_id, distance_m in distances_m.items() if distance_m < LIMIT_M)
print(f"{len(near)} points are {distances_m[1]:g} m from the camera that sees them, {len(points) - len(near)} {distances_m[2]:g} m; {len(kept)} are kept, of the pictures {[(point_id - 1) // 2 for point_id in kept]}")
assert len(near) == PICTURES and kept == near[:10] and {distances_m[point_id] for point_id in near} == {8.0}
PYTHON
venv/bin/python distances.py 2>said.txt || { cat said.txt; exit 1; }
if grep -iE "warn|error" said.txt; then exit 1; fi
