#!/usr/bin/env bash
# A vehicle drives at 10 m/s while its lidar turns, 0.1 s a revolution. The cloud is straightened with the devkit of the Boreas dataset, `remove_motion`,
# as it comes, and with the same points in another order: by ring, as organised clouds are, or shuffled. Where are the points?
# Guess: at the same places, up to 0.05 m, as it takes 20 steps of time; for points that are in no order it is slower, as its source says.
# Seen with asrl-pyboreas 2.0.0 on 2026-11-29, without a word: those in order of time are well. In any other order NOTHING is moved, and points are up to
# 0.5 m off, as before: they are handed to processes of their own, each of which straightens a copy that nobody gets back.
# And `project_onto_image`, "to select only points that project onto image", has those behind the camera as well, mirrored through its centre, with
# a negative depth as colour: 10 m behind looks like 10 m ahead.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check asrl-pyboreas==2.0.0 numpy==1.26.4
cd "$folder"
venv/bin/python - <<'PYTHON'
import numpy as np
from pyboreas.data.pointcloud import PointCloud

SPEED_MPS = 10.0

rng = np.random.default_rng(0)
time_s = np.linspace(0.0, 0.1, 1001)
there = rng.uniform(-30, 30, (len(time_s), 3))  # at the middle of the revolution
seen = there - np.outer(time_s - 0.05, [SPEED_MPS, 0, 0])
ring = rng.integers(0, 32, len(time_s))
cloud = np.c_[seen, np.zeros(len(time_s)), ring, time_s]
rate = np.array([[SPEED_MPS, 0, 0, 0, 0, 0]]).T


def off_m(order):
    """Return how far points are from where they were, at most, before and after they are straightened in this order."""
    straight = PointCloud(cloud[order]).remove_motion(rate, in_place=False)
    return [np.linalg.norm(points[:, :3] - there[order], axis=1).max() for points in (cloud[order], straight)]


for name, order in (("time", np.arange(len(ring))), ("ring", np.argsort(ring, kind="stable")), ("shuffled", rng.permutation(len(ring)))):
    before_m, after_m = off_m(order)
    print(f"by {name}: {before_m:.3f} m off before, {after_m:.3f} m after")
    assert abs(before_m - 0.5) < 1e-9
    assert (after_m < 0.06) if name == "time" else (after_m == before_m)

camera = np.array([[1000.0, 0, 1224, 0], [0, 1000, 1024, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
pixels, depth_m, _ = PointCloud(np.array([[1.0, 0.5, 10, 0, 0, 0], [-1, -0.5, -10, 0, 0, 0]])).project_onto_image(camera)
print(f"pixels {pixels.tolist()}, depths {depth_m.tolist()}")
assert pixels.tolist() == [[1324, 1074], [1324, 1074]] and depth_m.tolist() == [10, -10]
PYTHON
