#!/usr/bin/env bash
# A fisheye of 200 degrees (equidistant, 4 coefficients) sees what is 95 degrees off its axis. Where does `cv2.fisheye.projectPoints` put
# it, and what does `undistortPoints` make of its pixel? Guess: at the radius that the model has for 95 degrees, as the model is one of
# angles and so has no edge at 90; at least, an error or NaN.
# Seen with opencv-python-headless 4.14.0.94 on 2026-11-28: on the opposite side of the image. A point to the right at 95 degrees is put
# where one to the left at 85 is, which is inside of the image: labels of objects beside and behind the car land mirrored on what
# is before it, without a word. Of the right pixel, `undistortPoints` makes a ray that looks ahead, at 89 degrees.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check numpy==2.4.6 opencv-python-headless==4.14.0.94
cd "$folder"
venv/bin/python - <<'PYTHON'
import cv2
import numpy as np

K, D = np.array([[300.0, 0, 600], [0, 300, 600], [0, 0, 1]]), np.array([0.01, -0.002, 0, 0])


def by_model(angle):
    return 600 + 300 * np.sign(angle) * abs(angle + D[0] * angle**3 + D[1] * angle**5)


def by_opencv(angle):
    ray = np.array([[[np.sin(angle), 0, np.cos(angle)]]])
    return cv2.fisheye.projectPoints(ray, np.zeros(3), np.zeros(3), K, D)[0][0, 0, 0]


for degrees, mirrored in ((60, None), (89, None), (95, -85), (100, -80)):
    angle = np.radians(degrees)
    u = by_opencv(angle)
    print(f"{degrees} degrees: model {by_model(angle):.1f}, OpenCV {u:.1f}")
    assert np.isclose(u, by_model(angle if mirrored is None else np.radians(mirrored)))
    assert 0 < u < 1200 and 0 < by_model(angle) < 1200
back = cv2.fisheye.undistortPoints(np.array([[[by_model(np.radians(95)), 600.0]]]), K, D)[0, 0]
print(f"the pixel of 95 degrees: a ray at {np.degrees(np.arctan(back[0])):.1f} degrees")
assert 88 < np.degrees(np.arctan(back[0])) < 90
PYTHON
