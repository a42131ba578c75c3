#!/usr/bin/env bash
# A camera of Argoverse 2 (1550 x 2048, focal length 1684 pixels) whose optical centre lies 20 pixels to the left and 12 below the middle of its image, as
# calibration has it. A point is projected with the devkit, and its pixel is turned back into a ray. Guess: the ray leads to the point.
# Seen with av2 0.3.6 on 2026-11-29, without a word: it misses a point 50 m ahead by 0.69 m. `project_cam_to_img` takes the optical centre,
# `compute_pixel_ray_directions` ("given coordinates and intrinsics") half of width and height. The planes of the view frustum, by which lines and
# boxes are clipped, take the middle as well: a point that projects 10 pixels within the image lies outside of its frustum.
# The class is the file in the wheel; torch and what else `av2` requires is not needed for it.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check numpy==2.4.6 scipy==1.17.1 universal-pathlib==0.3.10
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check --no-deps av2==0.3.6
"$folder/venv/bin/python" - <<'PYTHON'
import sys
import types

import numpy as np

sys.modules["av2.utils.io"] = types.ModuleType("av2.utils.io")  # reads files with pandas and OpenCV, of which nothing is used here
from av2.geometry.camera.pinhole_camera import Intrinsics, PinholeCamera  # noqa: E402
from av2.geometry.se3 import SE3  # noqa: E402

WIDTH, HEIGHT, FOCAL_PX, DEPTH_M = 1550, 2048, 1684.0, 50.0
cameras = {
    name: PinholeCamera(
        ego_SE3_cam=SE3(rotation=np.eye(3), translation=np.zeros(3)),
        intrinsics=Intrinsics(FOCAL_PX, FOCAL_PX, WIDTH / 2 + off_px[0], HEIGHT / 2 + off_px[1], WIDTH, HEIGHT),
        cam_name="ring_front_center",
    )
    for name, off_px in {"in the middle": (0, 0), "calibrated": (-20, 12)}.items()
}
point_cam = np.array([[3.0, -1.0, DEPTH_M]])
missed_m = {}
for name, camera in cameras.items():
    pixel, _, valid = camera.project_cam_to_img(point_cam)
    (ray,) = camera.compute_pixel_ray_directions(pixel)
    missed_m[name] = float(np.linalg.norm(ray * DEPTH_M / ray[2] - point_cam[0]))
    print(f"{name}: pixel {pixel[0].round(1).tolist()}, the ray misses the point by {missed_m[name]:.2f} m")
    assert valid.all()
assert np.isclose(missed_m["in the middle"], 0) and np.isclose(missed_m["calibrated"], np.hypot(20, 12) * DEPTH_M / FOCAL_PX)

camera = cameras["calibrated"]
right_cam = np.array([[(WIDTH - 10 - camera.intrinsics.cx_px) * DEPTH_M / FOCAL_PX, 0, DEPTH_M]])  # 10 pixels from the right border
pixel, _, valid = camera.project_cam_to_img(right_cam)
distances = camera.frustum_planes() @ np.append(right_cam, 1)
print(f"pixel {pixel[0].round(1).tolist()} of {WIDTH} x {HEIGHT}; distances to the planes of the frustum {distances.round(2).tolist()}")
assert valid.all() and distances.min() < 0
PYTHON
