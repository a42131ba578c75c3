#!/usr/bin/env bash
# The calibration of a stereo camera (OAK) is read with DepthAI: the design of its board says 7.5 cm between the two, calibration 7.4 cm. And
# the intrinsics of its colour camera, 1920 x 1080, are wanted for images of 640 x 480. What do the functions of `CalibrationHandler` say?
# Guess: metres, from the calibration; a focal length of 667 pixels, as an image of another shape is cut out of the middle.
# Seen with depthai 3.12.0 on 2026-11-29:
#   getCameraExtrinsics            -7.4: calibration, in centimetres
#   getCameraTranslationVector     -7.5: the design, though its first line says "from the calibration data"
#   getBaselineDistance             7.5: the design, too; depth from disparity with it is 1.4 % too far
#   getCameraIntrinsics(640, 480)   500 pixels: for the whole width, with bars above and below; 667 with `keepAspectRatio=False` in y alone
# `useSpecTranslation=False` gives 7.4 from each.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check depthai==3.12.0 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import depthai
import numpy as np

COLOUR, LEFT, RIGHT = (getattr(depthai.CameraBoardSocket, f"CAM_{letter}") for letter in "ABC")
TURNED = np.eye(3).tolist()

handler = depthai.CalibrationHandler()
for socket, width, height, focal in ((COLOUR, 1920, 1080, 1500.0), (LEFT, 1280, 800, 800.0), (RIGHT, 1280, 800, 800.0)):
    handler.setCameraIntrinsics(socket, [[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]], width, height)
handler.setCameraExtrinsics(LEFT, RIGHT, TURNED, [-7.4, 0.0, 0.0], [-7.5, 0.0, 0.0])
handler.setCameraExtrinsics(RIGHT, COLOUR, TURNED, [3.7, 0.0, 0.0], [3.75, 0.0, 0.0])

extrinsics = handler.getCameraExtrinsics(LEFT, RIGHT)[0][3]
translation, baseline = handler.getCameraTranslationVector(LEFT, RIGHT)[0], handler.getBaselineDistance(LEFT, RIGHT)
measured = handler.getCameraTranslationVector(LEFT, RIGHT, False)[0], handler.getBaselineDistance(LEFT, RIGHT, False)
padded = np.array(handler.getCameraIntrinsics(COLOUR, 640, 480))
stretched = np.array(handler.getCameraIntrinsics(COLOUR, 640, 480, keepAspectRatio=False))
print(f"{extrinsics:.2f}, {translation:.2f}, {baseline:.2f}, measured {np.round(measured, 2)}")
print(f"640 x 480: {padded.tolist()}; keepAspectRatio=False {np.round(stretched, 1).tolist()}")
assert np.allclose((extrinsics, translation, baseline, *measured), (-7.4, -7.5, 7.5, -7.4, 7.4))
assert "from the calibration data" in depthai.CalibrationHandler.getCameraTranslationVector.__doc__
assert np.allclose(padded, [[500, 0, 320], [0, 500, 240], [0, 0, 1]])
assert np.allclose(stretched, [[500, 0, 320], [0, 2000 / 3, 240], [0, 0, 1]])
PYTHON
