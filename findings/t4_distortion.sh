#!/usr/bin/env bash
# A T4 dataset (TIER IV's kin of nuScenes) has cameras with lens distortion. Its devkit projects lidar points onto an image, with the distortion of
# the camera as it is set up. Where does a point land that is 20 m ahead, 1 m to the right, 0.5 m down? Guess: where OpenCV puts it with
# these coefficients; without any distortion, at (1010, 565), for a focal length of 1000 pixels and a centre at (960, 540).
# Seen with t4-devkit 0.1.0 and opencv-python-headless 4.14.0.94 on 2026-11-29, without a word:
#   no distortion given    (1010, 565)
#   five coefficients of 0   (98, 52): the model is given metres in place of x/z, y/z, and then the whole pixel, its centre
#                            included, is divided by the depth. What is 20 m away shrinks into a twentieth of the image, at its upper left
#   k1 = -0.3, k2 = 0.1    (87, 47), OpenCV (1010, 565): near the axis this lens hardly distorts
# So with five zeros, which is what a camera without distortion has, no point is where it is. `project_pointcloud(…, ignore_distortion=True)`
# puts points where a lens without distortion would.
# The function is the file in the wheel; Rerun and what else the devkit imports is not needed for it.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check \
  numpy==2.4.6 opencv-python-headless==4.14.0.94 pyquaternion==0.9.9 pycocotools==2.0.11 typing-extensions==4.15.0
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check --no-deps t4-devkit==0.1.0
"$folder/venv/bin/python" - <<'PYTHON'
import importlib.util
import sys
import types

import cv2
import numpy as np

(folder,) = importlib.util.find_spec("t4_devkit").submodule_search_locations
package = types.ModuleType("t4_devkit")  # the package without its __init__, which imports all of it
package.__path__ = [folder]
sys.modules["t4_devkit"] = package
common = types.ModuleType("t4_devkit.common")
common.__path__ = [f"{folder}/common"]
sys.modules["t4_devkit.common"] = common
from t4_devkit.common.geometry import view_points  # noqa: E402

INTRINSIC = np.array([[1000.0, 0, 960], [0, 1000, 540], [0, 0, 1]])
POINTS = np.array([[1.0, 0.5, 20]])
LENSES = {"none": None, "five zeros": np.zeros(5), "a lens": np.array([-0.3, 0.1, 0, 0, 0])}
seen = {name: view_points(POINTS.T, INTRINSIC, lens, normalize=True)[:2, 0].round(1).tolist() for name, lens in LENSES.items()}
right = {name: cv2.projectPoints(POINTS, np.zeros(3), np.zeros(3), INTRINSIC, lens)[0].ravel().round(1).tolist() for name, lens in LENSES.items()}
for name in LENSES:
    print(f"{name}: t4-devkit {seen[name]}, OpenCV {right[name]}")
assert seen["none"] == right["none"] == right["five zeros"] == [1010, 565]
assert seen["five zeros"] == [98, 52]
assert np.allclose(seen["a lens"], [87.1, 46.5], atol=0.1) and np.allclose(right["a lens"], [1010, 565], atol=0.1)
PYTHON
