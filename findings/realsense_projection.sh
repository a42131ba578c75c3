#!/usr/bin/env bash
# A point is projected with the intrinsics of a RealSense camera, and its pixel is brought back with its depth, by the two functions that
# librealsense has for it. Is it the same point, for each model of distortion?
# Guess: yes, up to what iterations leave. Seen with pyrealsense2 2.59.1.11053 on 2026-11-29, for coefficients as large as of real lenses:
#   brown_conrady, inverse_brown_conrady, kannala_brandt4   yes, within 0.1 pixels
#   modified_brown_conrady   no: to project distorts, to deproject does not. 4 pixels away, without a word
#   ftheta   no: to deproject divides by atan(2 tan(w/2)), where 2 tan(w/2) would undo what to project does. 60 pixels away
# And `inverse_brown_conrady`, whose coefficients lead from a distorted pixel to a straight one by its name, is projected with the same formula
# as `modified_brown_conrady`, whose coefficients lead the other way.
# The 9 numbers of `extrinsics.rotation` are by columns: `np.reshape(3, 3)` of them is the inverse rotation.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check pyrealsense2==2.59.1.11053 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import numpy as np
import pyrealsense2 as rs

POINT_M = [0.5, 0.3, 1.0]
POLYNOMIAL = [0.1, -0.2, 0.001, 0.002, 0.05]
MODELS = {
    "brown_conrady": POLYNOMIAL,
    "inverse_brown_conrady": POLYNOMIAL,
    "kannala_brandt4": [0.1, -0.02, 0.001, 0.002, 0.0],
    "modified_brown_conrady": POLYNOMIAL,
    "ftheta": [0.9, 0.0, 0.0, 0.0, 0.0],
}

camera = rs.intrinsics()
camera.width, camera.height, camera.fx, camera.fy, camera.ppx, camera.ppy = 640, 480, 400.0, 400.0, 320.0, 240.0
pixels, off = {}, {}
for name, coefficients in MODELS.items():
    camera.model, camera.coeffs = getattr(rs.distortion, name), coefficients
    pixels[name] = rs.rs2_project_point_to_pixel(camera, POINT_M)
    back = rs.rs2_deproject_pixel_to_point(camera, pixels[name], POINT_M[2])
    off[name] = float(np.hypot(*(np.array(back[:2]) - POINT_M[:2]))) * 400
    print(f"{name}: pixel {np.round(pixels[name], 2)}, back at {np.round(back, 4)}, {off[name]:.2f} pixels away")
assert max(list(off.values())[:3]) < 0.1
assert np.isclose(off["modified_brown_conrady"], 3.92, atol=0.05)
assert np.isclose(off["ftheta"], 60.1, atol=0.2)
assert pixels["modified_brown_conrady"] == pixels["inverse_brown_conrady"]

turn = rs.extrinsics()
turn.rotation, turn.translation = [0, 1, 0, -1, 0, 0, 0, 0, 1], [0, 0, 0]
got = rs.rs2_transform_point_to_point(turn, [1.0, 0.0, 0.0])
print(f"x becomes {got}, of numpy's rows it would be {np.reshape(turn.rotation, (3, 3)) @ [1, 0, 0]}")
assert got == [0.0, 1.0, 0.0]
PYTHON
