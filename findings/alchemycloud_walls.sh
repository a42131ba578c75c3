#!/usr/bin/env bash
# A room of 10 m x 10 m is mapped as voxels (OctoMap and the like: the centre of each that is occupied, in steps of 0.1 m). alchemycloud makes a map for ROS of it, in cells of 0.1 m, with its
# default, `projection`, and with `voxel3d`; both are flattened from the same points. Guess: four walls without a gap, one cell per column of voxels, with either.
# Seen with alchemycloud 1.3.0 on 2026-11-30, without a word: `voxel3d` has them; by `projection` a fifth of each wall is missing, in 20 gaps of a cell.
# The grid starts at the first centre, so that each centre is on the border of two cells, and rounding decides which of them it is in. Each wall has 1 gap in cells of 0.05 m, 2 of 0.2 m
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3.11 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check open3d==0.19.0 numpy==2.4.6 pyyaml==6.0.4 pillow==13.0.0 2>/dev/null
venv/bin/pip install --quiet --disable-pip-version-check --no-deps alchemycloud==1.3.0 2>/dev/null
cat >walls.py <<'PYTHON'
from pathlib import Path

import numpy as np
import open3d as o3d
import yaml
from alchemycloud.occupancy import GridParams, build, save
from PIL import Image


def gaps(voxel_m, method):
    """Return how many cells are not occupied of each of the room's four walls, the shape of the map and its origin."""
    count = round(10 / voxel_m)
    along = np.arange(-count // 2, count // 2)
    rows, columns, heights = (axis.ravel() for axis in np.meshgrid(along, along, np.arange(round(2 / voxel_m)), indexing="ij"))
    is_wall = np.isin(rows, along[[0, -1]]) | np.isin(columns, along[[0, -1]])
    centres_m = (np.column_stack([columns, rows, heights])[is_wall] + 0.5) * voxel_m
    params = GridParams(resolution=voxel_m, method=method)
    save(build(o3d.geometry.PointCloud(o3d.utility.Vector3dVector(centres_m)), params), "room.pgm", params)
    meta = yaml.safe_load(Path("room.yaml").read_text())
    with Image.open(meta["image"]) as image:
        occupied = np.asarray(image) == 0
    rows, columns = np.nonzero(occupied)
    room = occupied[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]
    return [int((~wall).sum()) for wall in (room[0], room[-1], room[:, 0], room[:, -1])], occupied.shape, meta["origin"]


SEEN = {0.05: 1, 0.1: 20, 0.2: 2}
for voxel_m, count in SEEN.items():
    cells = round(10 / voxel_m)
    for method, expected, margin in (("projection", count, 9), ("voxel3d", 0, 10)):
        missing, shape, origin = gaps(voxel_m, method)
        print(f"cells of {voxel_m} m, {method}: of {cells} cells, each wall lacks {missing}; the map is {shape}, from {origin}")
        assert missing == [expected] * 4 and shape == (cells + margin,) * 2
PYTHON
venv/bin/python walls.py >walls.txt 2>&1 || { cat walls.txt; exit 1; }
cat walls.txt
if grep -i warn walls.txt; then exit 1; fi
