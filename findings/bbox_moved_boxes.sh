#!/usr/bin/env bash
# Boxes of a tracker are judged with bbox, "Python library for 2D/3D bounding boxes" (`BBox3D`, whose z is that of its centre, and `iou_3d`). A car's box of 4 x 2 x 1.5 m is moved: by its
# centre (`box.center = …`) or by one of its coordinates (`box.cx = …`); and it is compared with a box of 3 m on top of it that starts half-way up.
# Guess: corners and IoU follow; the IoU of the tall box is 0.2.
# Seen with bbox 0.9.4 on 2026-11-30, without a word:
# - `cx` set from 20 to 30 m: its corners stay at 18 to 22 m, `center` too, and a box at 20 m still has an IoU of 1 with it
# - `center` set 3 m higher: its corners follow, `cz` and the IoU do not: 1 in place of 0
# - the tall box: an IoU of 0.5, since heights are compared as if z were that of the top, as KITTI's y is of the bottom; boxes of equal heights are right
# - a corner in place of a centre (`is_center=False`): half the length is added along x also if the box is turned, so the given corner is none of its corners
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check bbox==0.9.4 numpy==1.26.4 pyquaternion==0.9.9 2>/dev/null
cat > boxes.py <<'PYTHON'
import numpy as np
from bbox import BBox3D
from bbox.metrics import iou_3d


def car(x=20.0, z=0.75, height=1.5, **others):
    return BBox3D(x, 0.0, z, 4.0, 2.0, height, **others)


moved = car()
moved.cx = 30.0
print("cx:", moved.cx, "center:", moved.center, "corners from", moved.p[:, 0].min(), "to", moved.p[:, 0].max(), "IoU with the box of before:", iou_3d(car(), moved))
assert moved.cx == 30 and moved.center[0] == 20 and (moved.p[:, 0].min(), moved.p[:, 0].max()) == (18, 22) and iou_3d(car(), moved) == 1

lifted = car()
lifted.center = np.array([20, 0, 3.75])
print("lifted by 3 m: corners from", lifted.p[:, 2].min(), "m up, cz", lifted.cz, "IoU", iou_3d(car(), lifted))
assert lifted.p[:, 2].min() == 3 and lifted.cz == 0.75 and iou_3d(car(), lifted) == 1
assert iou_3d(car(), car(z=3.75)) == 0

tall = car(z=2.25, height=3.0)
common_m = min(1.5, tall.p[:, 2].max()) - max(0, tall.p[:, 2].min())
right = common_m / (1.5 + 3 - common_m)
print("tall:", iou_3d(car(), tall), "and", round(right, 3), "is right; as high as the car:", iou_3d(car(), car(z=1.5)))
assert iou_3d(car(), tall) == 0.5 and np.isclose(right, 0.2) and iou_3d(car(), car(z=1.5)) == 0.33333

corner = np.array([20, 0, 0.75])
turned = car(is_center=False, rw=np.sqrt(0.5), rz=np.sqrt(0.5))
nearest_m = np.linalg.norm(turned.p - corner, axis=1).min()
print("by a corner, turned by 90 degrees: nearest corner to it", nearest_m.round(2), "m away")
assert nearest_m > 1 and np.allclose(np.linalg.norm(car(is_center=False).p - corner, axis=1).min(), 0)
PYTHON
venv/bin/python boxes.py > said.txt 2>&1 || { tail -5 said.txt; exit 1; }
if grep -i warn said.txt; then exit 1; fi
cat said.txt
