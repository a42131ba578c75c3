#!/usr/bin/env bash
# A disparity image of a stereo camera becomes points: `cv2.reprojectImageTo3D(…, handleMissingValues=True)`, so that pixels without a disparity can be told from
# the others. A wall is at 5 m, a pole at 10 m; then a pixel is lost (-1, as StereoSGBM marks it after a division by 16), and one has the disparity 0.
# Guess: what is lost is at 10,000 m, or infinitely far, and all else where it is.
# Seen with opencv-python-headless 4.14.0.94 and 5.0.0.93 on 2026-11-29, without a word:
# - where no pixel is lost, the POLE is at 10,000 m, all of it: "missing" is whatever has the smallest disparity in the image, so the farthest thing that was seen
# - with one lost, that is at 10,000 m, and the pole where it is; so a static thing comes and goes from image to image
# - two kinds of lost pixels, -1 and -2: only the smaller one counts, the other is 50 m BEHIND the camera; and disparity 0 is infinitely far
# - int16 as StereoSGBM gives it, in sixteenths of a pixel, is taken as it is: the wall is at 0.31 m
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cat > "$folder/walls.py" <<'PYTHON'
import cv2
import numpy as np

FOCAL_PX, BASELINE_M = 500.0, 0.1
Q = np.float64([[1, 0, 0, -320], [0, 1, 0, -240], [0, 0, 0, FOCAL_PX], [0, 0, 1 / BASELINE_M, 0]])


def distances_m(disparities):
    return cv2.reprojectImageTo3D(disparities, Q, handleMissingValues=True)[..., 2].ravel()


wall_px, pole_px = FOCAL_PX * BASELINE_M / np.float32([5.0, 10.0])
seen = np.float32([[wall_px, wall_px, pole_px, pole_px, wall_px, wall_px]])
print(f"OpenCV {cv2.__version__}: nothing lost {distances_m(seen)}")
assert distances_m(seen).tolist() == [5, 5, 10_000, 10_000, 5, 5]
lost = seen.copy()
lost[0, 0] = -1
print(f"one lost {distances_m(lost)}")
assert distances_m(lost).tolist() == [10_000, 5, 10, 10, 5, 5]
lost[0, 1], lost[0, 5] = -2, 0
print(f"two lost, one 0: {distances_m(lost)}")
assert distances_m(lost).tolist() == [-50, 10_000, 10, 10, 5, np.inf]
assert abs(distances_m((seen * 16).astype(np.int16))[0] - 5 / 16) < 1e-6
PYTHON
for version in 4.14.0.94 5.0.0.93; do
  python3 -m venv "$folder/$version"
  "$folder/$version/bin/pip" install --quiet --disable-pip-version-check opencv-python-headless==$version numpy==2.4.6
  "$folder/$version/bin/python" "$folder/walls.py"
done
