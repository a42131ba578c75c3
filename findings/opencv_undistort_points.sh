#!/usr/bin/env bash
# A wide-angle camera of 127 degrees, 1920 x 1080, k1 = -0.35 and k2 = 0.1, which is monotonic out to its corners. `cv2.undistortPoints` is
# asked for the rays of the pixels at which `cv2.projectPoints` sees points at x/z = 1.0, 1.5, 1.8 and 2.0 (the border).
# Guess: these four numbers, or NaN where it fails. Seen with opencv-python-headless 4.14.0.94 on 2026-11-29: 0.997, 1.497, 2.013 and 0.932,
# without a word: the ray at the border looks 43 degrees to the side in place of 63, and a point that is farther out is nearer to the axis.
# It stops after 5 iterations, whether they lead anywhere or not. `undistortPointsIter`, with (3, 1000, 1e-12), has all four.
# Whoever checks his calibration near the middle sees nothing: at 0.5 it is right.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check opencv-python-headless==4.14.0.94 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import cv2
import numpy as np

K = np.array([[400.0, 0.0, 960.0], [0.0, 400.0, 540.0], [0.0, 0.0, 1.0]])
D = np.array([-0.35, 0.1, 0.0, 0.0])
true = np.array([0.5, 1.0, 1.5, 1.8, 2.0])
points = np.column_stack([true, np.zeros(5), np.ones(5)])
pixels, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), K, D)
radii = np.linspace(0.0, 2.3, 1000)
assert (np.diff(radii * (1 + D[0] * radii**2 + D[1] * radii**4)) > 0).all()  # each pixel has one ray
five = cv2.undistortPoints(pixels, K, D)[:, 0, 0]
many = cv2.undistortPointsIter(pixels, K, D, None, None, (3, 1000, 1e-12))[:, 0, 0]
for x, u, got, better in zip(true, pixels[:, 0, 0], five, many):
    print(f"column {u:.1f}: x/z = {got:.3f} in place of {x}; with more iterations {better:.6f}")
assert np.allclose(five, [0.5, 0.997, 1.497, 2.013, 0.932], atol=1e-3)
assert np.allclose(many, true, atol=1e-6)
PYTHON
