#!/usr/bin/env bash
# A grasp in an image is a point and an angle: where a gripper closes, and how it is turned. It is augmented with the image by albumentations, as a keypoint of
# format "xya", in degrees; the tip of the gripper is a second keypoint, so each transform says itself where it has turned to.
# Guess: the angle turns with the image. Seen with albumentations 2.0.8 on 2026-11-30, without a word:
# - by `HorizontalFlip`, `VerticalFlip`, `Transpose`, `RandomRotate90`: yes
# - by `Rotate` and `Affine(rotate=...)` of 40 degrees: the other way round, so by 80 degrees off. `SafeRotate` likewise
# - by `Resize` to another shape, `Affine(scale=...)` of one axis, `Affine(shear=...)`: not at all, though the tip has turned by 6 to 19 degrees
# The point is right in each.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check albumentations==2.0.8 opencv-python-headless==4.14.0.94 numpy==2.4.6 2>/dev/null
cd "$folder"
NO_ALBUMENTATIONS_UPDATE=1 venv/bin/python - <<'PYTHON'
import math

import albumentations as A
import numpy as np

CENTRE, ANGLE_DEG, REACH = (80.0, 50.0), 30.0, 20.0
tip = (CENTRE[0] + REACH * math.cos(math.radians(ANGLE_DEG)), CENTRE[1] + REACH * math.sin(math.radians(ANGLE_DEG)))
image = np.zeros((100, 160), np.uint8)


def turned(transform, form, keypoints):
    params = A.KeypointParams(format=form, remove_invisible=False)
    return A.Compose([transform], keypoint_params=params, seed=3)(image=image, keypoints=keypoints)["keypoints"]


right, wrong_way, not_turned = "right", "the other way", "not turned"
for name, transform, expected in (
    ("HorizontalFlip", A.HorizontalFlip(p=1), right),
    ("VerticalFlip", A.VerticalFlip(p=1), right),
    ("Transpose", A.Transpose(p=1), right),
    ("RandomRotate90", A.RandomRotate90(p=1), right),
    ("Rotate by 40", A.Rotate((40, 40), p=1), wrong_way),
    ("Affine, rotate by 40", A.Affine(rotate=(40, 40), p=1), wrong_way),
    ("SafeRotate by 40", A.SafeRotate((40, 40), p=1), wrong_way),
    ("Resize to 160 x 200", A.Resize(200, 160, p=1), not_turned),
    ("Affine, scale x by 0.5", A.Affine(scale={"x": (0.5, 0.5), "y": (1, 1)}, p=1), not_turned),
    ("Affine, shear by 20", A.Affine(shear={"x": (20, 20), "y": (0, 0)}, p=1), not_turned),
):
    ((x, y, angle_deg),) = turned(transform, "xya", [(*CENTRE, ANGLE_DEG)])
    (x0, y0), (x1, y1) = turned(transform, "xy", [CENTRE, tip])
    true_deg = math.degrees(math.atan2(y1 - y0, x1 - x0))
    off_deg = (angle_deg - true_deg + 180) % 360 - 180
    print(f"{name}: angle {angle_deg % 360:.1f}, the tip's {true_deg % 360:.1f}: {expected}")
    assert np.allclose((x, y), (x0, y0))
    if expected == right:
        assert abs(off_deg) < 0.1
    elif expected == wrong_way:
        assert 60 < abs(off_deg) < 85
    else:
        assert np.isclose(angle_deg, ANGLE_DEG) and 5 < abs(off_deg) < 20
PYTHON
