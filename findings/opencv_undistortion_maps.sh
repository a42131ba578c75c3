#!/usr/bin/env bash
# Are OpenCV's undistortion maps the same on every processor if one asks for floats (CV_32FC1) and rounds them oneself?
# Guess: yes. `initUndistortRectifyMap` computes in double precision, and only CV_16SC2, which rounds inside, differs.
# Seen with opencv-python-headless 4.14.0.94 on x86-64, 2026-11-28, with and without AVX2 (`OPENCV_CPU_DISABLE`): no.
# Of 312 cameras with plain numbers, float maps differ for 198 (in their last bit), rounded to 1/32 pixel for 53, and
# CV_16SC2 for 228. Through the latter, 35 pixels of a grey image of 1600 x 900 (f 1000, D -0.2) differ, by up to 6.
# Such numbers (principal point in the middle, one or two radial coefficients) put many pixels exactly between two 32nds
# of a pixel, where the last bit decides. Fails once nothing differs; without AVX2 there is nothing to compare, and it passes.
set -euo pipefail

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/env"
"$folder/env/bin/pip" install --quiet --disable-pip-version-check opencv-python-headless==4.14.0.94 numpy==2.4.6

cat > "$folder/maps.py" <<'PYTHON'
import hashlib
import itertools
import json
import sys

import cv2
import numpy as np

AVX2 = 11  # CV_CPU_AVX2, which has no name in Python
cv2.setNumThreads(1)


def digest(*arrays):
    return hashlib.sha256(b"".join(np.ascontiguousarray(one).tobytes() for one in arrays)).hexdigest()


def maps(size, f, d, zoom, kind):
    (width, height), centre = size, (size[0] / 2, size[1] / 2)
    lens = np.array([[f, 0, centre[0]], [0, f, centre[1]], [0, 0, 1.0]])
    pinhole = np.array([[f * zoom, 0, centre[0]], [0, f * zoom, centre[1]], [0, 0, 1.0]])
    return cv2.initUndistortRectifyMap(lens, np.array(d), np.eye(3), pinhole, size, kind)


made = {"avx2": bool(cv2.checkHardwareSupport(AVX2)), "float": [], "rounded": [], "fixed": []}
sizes = [(640, 480), (1280, 720)]
lenses = [(-0.2, 0, 0, 0, 0), (-0.1, 0, 0, 0, 0), (-0.25, 0.0625, 0, 0, 0), (-0.3, 0.1, 0, 0, 0)]
for size, f, d, zoom in itertools.product(sizes, range(320, 1300, 80), lenses, (1.0, 0.8, 0.5)):
    u, v = maps(size, f, d, zoom, cv2.CV_32FC1)
    made["float"].append(digest(u, v))
    made["rounded"].append(digest(np.rint(u * 32), np.rint(v * 32)))
    made["fixed"].append(digest(*maps(size, f, d, zoom, cv2.CV_16SC2)))
rows, columns = np.mgrid[0:900, 0:1600]
image = ((rows * 101 + columns * 67 + rows * columns * 29) % 256).astype(np.uint8)
through = cv2.remap(image, *maps((1600, 900), 1000, lenses[0], 1.0, cv2.CV_16SC2), cv2.INTER_LINEAR)
np.save(sys.argv[1], through)
json.dump(made, sys.stdout)
PYTHON

run() { "$folder/env/bin/python" "$folder/maps.py" "$1"; }
run "$folder/new.npy" > "$folder/new.json"
OPENCV_CPU_DISABLE=AVX2 run "$folder/old.npy" > "$folder/old.json"

"$folder/env/bin/python" - "$folder" <<'PYTHON'
import json
import sys
from pathlib import Path

import numpy as np

folder = Path(sys.argv[1])
new, old = (json.loads((folder / f"{name}.json").read_text()) for name in ("new", "old"))
if not new["avx2"]:
    print("this processor has no AVX2, so there is nothing to compare")
    sys.exit(0)
differ = {kind: sum(a != b for a, b in zip(new[kind], old[kind])) for kind in ("float", "rounded", "fixed")}
pixels = np.abs(np.load(folder / "new.npy").astype(int) - np.load(folder / "old.npy"))
print(f"of {len(new['float'])} cameras, maps differ without AVX2: {differ}")
print(f"of one image, {np.count_nonzero(pixels)} pixels differ, by up to {pixels.max()}")
sys.exit(0 if all(differ.values()) and pixels.any() else 1)
PYTHON
