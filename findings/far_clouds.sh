#!/usr/bin/env bash
# Two clouds of a building, half a metre apart, are in UTM coordinates, as surveys and maps are: eastings of 691 km, northings of 5330 km. They are aligned with
# small_gicp (`align`), and an occupancy map with cells of 0.1 m is made of one with OctoMap. The same again with coordinates that begin nearby.
# Guess: the same but for rounding, since both take float64; or an error, if there is no room.
# Seen with small-gicp 1.0.1 and pyoctomap 1.2.2 on 2026-11-29. Both print a warning for each point to the standard error (hundreds of thousands for a lidar), and answer:
# - small_gicp: "converged", after 0 iterations: the identity, with an error of 0. It has 21 bits for a cell's number in each direction, so with cells of 0.25 m
#   it ends at 262 km; all that is beyond is in ONE cell, and one point is left of each cloud
# - OctoMap has 16 bits, so with cells of 0.1 m it ends at 3.3 km: the map has no cell at all, and `insertPointCloud` returns the number of all points
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check small-gicp==1.0.1 pyoctomap==1.2.2 numpy==2.4.6
cd "$folder"
cat > far.py <<'PYTHON'
import numpy as np
import pyoctomap
import small_gicp

UTM_M = np.array([691_600.0, 5_330_004.0, 500.0])
MOVED_M = np.array([0.5, 0.2, 0.05])
rng = np.random.default_rng(0)


def building():
    """Return points of a floor and two walls."""
    along, up = rng.uniform(-20, 20, (2, 3000)), rng.uniform(0, 5, 3000)
    flat = np.zeros(3000)
    return np.r_[np.c_[along[0], along[1], flat], np.c_[flat + 10, along[0], up], np.c_[along[1], flat - 8, up]] + rng.normal(0, 0.01, (9000, 3))


target, source = building(), building() - MOVED_M
for name, origin_m in (("nearby", np.zeros(3)), ("UTM", UTM_M)):
    result = small_gicp.align(target + origin_m, source + origin_m, downsampling_resolution=0.25)
    moved_m = result.T_target_source[:3, 3]
    tree = pyoctomap.OcTree(0.1)
    inserted = tree.insertPointCloud(target[::10] + origin_m, origin_m + [0, 0, 1])
    print(f"{name}: converged {result.converged} in {result.iterations}, moved by {moved_m.round(2)}; {inserted} points, {tree.size()} nodes")
    assert result.converged and inserted == 900
    if origin_m.any():
        assert np.array_equal(result.T_target_source, np.eye(4)) and result.error == result.iterations == 0
        assert tree.size() == 0
    else:
        assert np.allclose(moved_m, MOVED_M, atol=0.02) and tree.size() > 10_000
PYTHON
venv/bin/python far.py 2> warnings.txt
echo "$(wc -l < warnings.txt) lines of warnings, such as: $(grep -m 1 voxel warnings.txt)"
