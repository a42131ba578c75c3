#!/usr/bin/env bash
# A lidar's points on a parked car, 4 x 2 x 1.5 m, turned to the left by 0.5 rad, fill its box. The cloud and its label are augmented with lidar-aug: flipped along y, turned about z, and the car alone
# made larger or smaller. A label is (x, y, z, width, height, length, theta), as its help and its error messages say. Guess: the points still fill the box.
# Seen with lidar-aug 1.0.1 and torch 2.2.0 on 2026-11-30, without a word:
# - `flip_random` mirrors points and centre, and adds half a turn to theta, which a box of cuboid shape is none the wiser for: it is turned by +0.5 in place of -0.5, 57 degrees off
# - `rotate_deg`, `rotate_rad` and `rotate_random` ("along the 'z' axis (yaw)") turn points and centres about the Y axis: by 90 degrees, what was 10 m ahead is 10 m above the lidar. Theta
#   of the boxes is turned as if it had been about z
# - `scale_local` moves a third of the points on the car: sizes are length, width, height there. In that order, all
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3.11 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check torch==2.2.0 numpy==1.26.4 scipy==1.11.4
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check --no-deps lidar-aug==1.0.1
cd "$folder"
venv/bin/python -W ignore - <<'PYTHON'
import sys
from unittest.mock import MagicMock

for drawing in ("open3d", "matplotlib", "matplotlib.pyplot"):
    sys.modules[drawing] = MagicMock()
import numpy as np
import torch
from lidar_aug import augmentations

CENTRE, YAW = np.array([10.0, 2.0, 0.5]), 0.5
LENGTH, WIDTH, HEIGHT = 4.0, 2.0, 1.5
torch.manual_seed(0)


def about_z(angle):
    return np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])


def scene(size):
    """Return the points that fill the car, and its label with `size`, three numbers."""
    edges = [np.linspace(-0.47 * side, 0.47 * side, count) for side, count in ((LENGTH, 9), (WIDTH, 5), (HEIGHT, 3))]
    inside = np.stack(np.meshgrid(*edges), axis=-1).reshape(-1, 3)
    points = np.c_[inside @ about_z(YAW).T + CENTRE, np.ones(len(inside))]
    return torch.tensor(points[None], dtype=torch.float32), torch.tensor([[[*CENTRE, *size, YAW]]], dtype=torch.float32)


def in_box(points, label):
    """Return the share of the points that is in the box of the label."""
    own = (points[0, :, :3].numpy() - label[0, 0, :3].numpy()) @ about_z(float(label[0, 0, 6]))
    return float((np.abs(own) <= np.array([LENGTH, WIDTH, HEIGHT]) / 2).all(axis=1).mean())


points, label = scene((WIDTH, HEIGHT, LENGTH))
assert in_box(points, label) == 1
augmentations.flip_random(points, label, 100)
print(f"flipped: centre at y = {label[0, 0, 1]:.1f}, theta {label[0, 0, 6]:.3f}, {in_box(points, label):.0%} of the points in the box")
assert np.isclose(label[0, 0, 6], YAW + np.pi, atol=1e-3) and in_box(points, label) < 0.8
label[0, 0, 6] = -YAW
assert in_box(points, label) == 1

for turn, angle in ((augmentations.rotate_deg, 90.0), (augmentations.rotate_rad, np.pi / 2)):
    points = torch.tensor([[[10.0, 0, 0, 1], [0, 10, 0, 1], [0, 0, 10, 1]]])
    turn(points, angle)
    assert np.allclose(points[0, :, :3], [[0, 0, 10], [0, 10, 0], [-10, 0, 0]], atol=0.01)
print("a quarter turn of x, y, z:", points[0, :, :3].round().int().tolist())
points, label = scene((WIDTH, HEIGHT, LENGTH))
augmentations.rotate_random(points, label, 20.0)
by = float(label[0, 0, 6]) - YAW
print(f"turned by {by:.2f} rad: centre at {label[0, 0, :3].numpy().round(2)}, {in_box(points, label):.0%} of the points in the box")
assert abs(by) > 0.05 and np.isclose(label[0, 0, 1], CENTRE[1]) and not np.isclose(label[0, 0, 2], CENTRE[2], atol=0.5) and in_box(points, label) < 0.9

for size, expected in (((WIDTH, HEIGHT, LENGTH), 1 / 3), ((LENGTH, WIDTH, HEIGHT), 1)):
    points, label = scene(size)
    before = points.clone()
    augmentations.scale_local(points, label, 0.2, 1.5)
    moved = (points != before).any(dim=-1).float().mean().item()
    print("sizes", size, f"scaled by {label[0, 0, 3] / size[0]:.2f}: {moved:.0%} of the points moved")
    assert np.isclose(moved, expected)
PYTHON
