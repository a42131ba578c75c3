#!/usr/bin/env bash
# Depth images of a simulated flight are saved as AirSim's client does it, as PFM in metres (`write_pfm`), and read with OpenCV: 10 m above in the image, a wall;
# 2 m below, the ground. And depth that OpenCV saved as PFM is read with AirSim's `read_pfm`.
# Guess: the same image, since PFM is one format. Seen with cosysairsim 3.5.0 and opencv-python-headless 5.0.0.93 on 2026-11-29, without a word: UPSIDE DOWN, both ways.
# PFM has its lowest row first, which OpenCV heeds, in both directions, and AirSim in neither: its own files are well for itself alone.
# The negative number in the header, which says little-endian, is right, so values are those that were measured.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check cosysairsim==3.5.0 opencv-python-headless==5.0.0.93 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import cv2
import numpy as np
from cosysairsim.utils import read_pfm, write_pfm

depth_m = np.repeat(np.float32([[10.0], [6.0], [2.0]]), 4, axis=1)
depth_m[:, 0] += 0.5

write_pfm("airsim.pfm", depth_m)
cv2.imwrite("opencv.pfm", depth_m)
for path in ("airsim.pfm", "opencv.pfm"):
    by_airsim, _ = read_pfm(path)
    by_opencv = cv2.imread(path, cv2.IMREAD_UNCHANGED)
    print(f"{path}: rows by airsim {by_airsim[:, 1].tolist()}, by opencv {by_opencv[:, 1].tolist()}")
    own, other = (by_airsim, by_opencv) if path.startswith("airsim") else (by_opencv, by_airsim)
    assert np.array_equal(own, depth_m)
    assert np.array_equal(other, depth_m[::-1])
PYTHON
