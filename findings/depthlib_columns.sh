#!/usr/bin/env bash
# A stereo pair of 640 pixels (focal length 500 pixels, baseline 0.1 m) sees a box in columns 300 to 399 of the left picture, before a wall. A band beside the box has no match, as usual. depthlib makes depth of it.
# In a second one the cameras' principal points lie 30 pixels apart (`doffs`, as in calibrations of Middlebury). Guess: depth of 640 columns, the box in 300 to 399; where there is no match, inf, as its help
# says, "Invalid regions are set to inf".
# Seen with depthlib 0.1.1 beside opencv-python-headless 5.0.0.93 on 2026-11-30, without a word:
# - depth of 512 columns, the box in 172 to 271: the left 128 (`num_disp`) are cut off, so what is looked up at a pixel of the picture, a box of a detector or a mask, is 128 pixels away. With another
#   `num_disp` the columns are others
# - with `doffs` of 30 each pixel has a depth: where OpenCV says "no match" (a disparity of -1), 30 is added, and 29 pixels are a surface at 1.72 m
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check matplotlib==3.11.2 pillow==13.0.0 opencv-python-headless==5.0.0.93 numpy==2.4.6 2>/dev/null
venv/bin/pip install --quiet --disable-pip-version-check --no-deps depthlib==0.1.1 2>/dev/null
cat > pair.py <<'PYTHON'
import cv2
import numpy as np
from depthlib.stereo_core import StereoCore

FOCAL_PX, BASELINE_M, WALL_PX, BOX_PX, FIRST, LAST = 500.0, 0.1, 40, 64, 300, 399
random = np.random.default_rng(0)


def texture(rows, columns):
    return cv2.GaussianBlur(random.integers(0, 256, (rows, columns), dtype=np.uint8), (3, 3), 0)


wall, box = texture(240, 840), texture(100, 100)
left, right = wall[:, 100:740].copy(), wall[:, 100 + WALL_PX : 740 + WALL_PX].copy()
left[70:170, FIRST : LAST + 1] = box
right[70:170, FIRST - BOX_PX : LAST + 1 - BOX_PX] = box
for offset_px in (0.0, 30.0):
    stereo = StereoCore()
    stereo.configure_sgbm(focal_length=FOCAL_PX, baseline=BASELINE_M, doffs=offset_px)
    disparity_px, depth_m = stereo.estimate_depth(left, right)
    near = np.isclose(depth_m, FOCAL_PX * BASELINE_M / (BOX_PX + offset_px), rtol=0.01)
    columns = np.flatnonzero(near.sum(axis=0) > 50)
    unmatched = depth_m[disparity_px < 0]
    print(
        f"doffs {offset_px:.0f}: picture {left.shape}, depth {depth_m.shape}, the box in columns {columns[0]} to {columns[-1]}; "
        f"{len(unmatched)} pixels without a match have {np.median(unmatched):.2f} m"
    )
    assert depth_m.shape == (240, 512) and abs(columns[0] - (FIRST - 128)) <= 3 and abs(columns[-1] - (LAST - 128)) <= 3 and len(unmatched) > 1000
    if offset_px:
        assert np.allclose(unmatched, FOCAL_PX * BASELINE_M / (offset_px - 1)) and np.isfinite(depth_m).all()
    else:
        assert np.isinf(unmatched).all()
PYTHON
venv/bin/python pair.py > said.txt 2>&1 || { tail -5 said.txt; exit 1; }
if grep -i warn said.txt; then exit 1; fi
cat said.txt
