#!/usr/bin/env bash
# A fisheye camera is calibrated with the double sphere model, as by basalt. Points of a lidar are projected into its images with dscamera, `world2cam`, which also says which of
# them are in view, for a field of view that one gives: 200 degrees, or 120 for the part of the image that is sharp. Guess: those whose ray is within 100, or 60, degrees of the axis,
# however far away they are. Seen with dscamera 0.0.4 on 2026-11-30, without a word:
# - which are in view depends on the distance: z in METRES is compared with the cosine of half the angle, which is right 1 m away. At 95 degrees what is nearer than 2 m is in view, the
#   rest not, 5 m or 50; with 120 degrees of view all that is ahead by more than 0.5 m is, up to 90 degrees, at which the image is no longer
# - pixels are right, and so is the way back, `cam2world`, where rays have length 1: a pixel at 95 degrees is in view, and the point it came from is not
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check dscamera==0.0.4 opencv-python-headless==4.14.0.94 numpy==2.4.6
venv/bin/python - <<'PYTHON'
import numpy as np
from dscamera import DSCamera

LENS = {"fx": 200.0, "fy": 200.0, "cx": 400.0, "cy": 400.0, "xi": -0.2, "alpha": 0.6}
DISTANCES_M = (0.5, 1.0, 1.9, 2.1, 5.0, 50.0)


def in_view(fov_deg, angle_deg):
    """Return, for points at these distances in one direction, whether they are in view, and whether their pixel is."""
    camera = DSCamera(img_size=(800, 800), intrinsic=LENS, fov=fov_deg)
    angle_rad = np.radians(angle_deg)
    ray = np.array([np.sin(angle_rad), 0, np.cos(angle_rad)])
    pixels, seen = camera.world2cam(np.multiply.outer(DISTANCES_M, ray))
    assert np.ptp(pixels, axis=0).max() < 1e-9
    back, pixel_seen = camera.cam2world([pixels[:1, 0], pixels[:1, 1]])
    assert np.allclose(back[0], ray)
    return seen.tolist(), bool(pixel_seen[0])


for fov_deg, angle_deg, expected, pixel_expected in (
    (200, 85, [True] * 6, True),
    (200, 95, [True, True, True, False, False, False], True),
    (120, 50, [False, True, True, True, True, True], True),
    (120, 80, [False, False, False, False, True, True], False),
):
    seen, pixel_seen = in_view(fov_deg, angle_deg)
    print(f"{fov_deg} degrees of view, at {angle_deg} from the axis: in view at {[metres for metres, yes in zip(DISTANCES_M, seen) if yes]} m; its pixel: {pixel_seen}")
    assert seen == expected and pixel_seen == pixel_expected
PYTHON
