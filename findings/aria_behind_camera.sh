#!/usr/bin/env bash
# Images of Project Aria's fisheye cameras are made straight by its library, for a pinhole camera that it makes (`get_linear_camera_calibration`), and labels in 3D
# are projected into them: `CameraCalibration.project`, which gives None for what is not visible. Where is what lies behind the camera, a metre back, 0.1 to the side?
# Guess: None, as `project_no_checks` is there for whoever wants a number. Seen with projectaria-tools 2.3.0 on 2026-11-29, without a word:
# - in the middle of the image, mirrored through its centre: only width and height are checked, and at z = 0. The camera that it makes has no limit of its angle
# - a fisheye camera (FISHEYE624) that is made with pi as the greatest angle likewise; with one as of a lens, 1.4 rad, it is None
# - its first pixel has its middle at (0, 0), as in OpenCV: 640 x 480 has its centre at (319.5, 239.5)
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check projectaria-tools==2.3.0
"$folder/venv/bin/python" -W ignore - <<'PYTHON'
import math

import numpy as np
from projectaria_tools.core.calibration import CameraCalibration, CameraModelType, get_linear_camera_calibration
from projectaria_tools.core.sophus import SE3

POINTS = {"ahead": (0.1, 0.05, 1.0), "behind": (0.1, 0.05, -1.0), "beside": (0.1, 0.05, 0.0), "far to the side": (10.0, 0.0, 1.0)}


def fisheye(greatest_rad):
    """Return a fisheye camera that sees up to this angle off its axis."""
    parameters = np.array([600.0, 703.5, 703.5, *[0.0] * 12])
    return CameraCalibration("camera", CameraModelType.FISHEYE624, parameters, SE3(), 1408, 1408, None, greatest_rad, "")


linear = get_linear_camera_calibration(640, 480, 500.0, "camera")
assert linear.get_principal_point().tolist() == [319.5, 239.5]
seen = {}
for name, camera in (("linear", linear), ("fisheye, pi", fisheye(math.pi)), ("fisheye, 1.4", fisheye(1.4))):
    pixels = {where: camera.project(np.array(point)) for where, point in POINTS.items()}
    seen[name] = {where: pixel if pixel is None else pixel.round(1).tolist() for where, pixel in pixels.items()}
    print(f"{name}: {seen[name]}")
assert seen["linear"] == {"ahead": [369.5, 264.5], "behind": [269.5, 214.5], "beside": None, "far to the side": None}
assert seen["fisheye, pi"]["ahead"] == [763.3, 733.4] and seen["fisheye, pi"]["behind"] == [643.7, 673.6]
assert seen["fisheye, 1.4"]["ahead"] == [763.3, 733.4] and seen["fisheye, 1.4"]["behind"] is None
PYTHON
