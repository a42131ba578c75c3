#!/usr/bin/env bash
# A round blob is drawn around the middle of pixel (100, 60), the first pixel being (0, 0) as in OpenCV and in ROS' camera models. Where do detectors see it, by whose
# points cameras are calibrated and posed? Guess: at (100, 60), to a hundredth of a pixel; by COLMAP, too, or its focal length and centre would not fit OpenCV's.
# Seen with opencv-python-headless 4.14.0.94 and pycolmap 4.2.1 on 2026-11-29, without a word:
#   SimpleBlobDetector, SIFT with `enable_precise_upscale=True`   (100, 60)
#   SIFT of OpenCV, as it is set up                               (100.24, 60.24), and so for every blob: a quarter of a pixel to the right and down
#   SIFT of COLMAP                                                (100.5, 60.5): there the MIDDLE of the first pixel is (0.5, 0.5)
# So a principal point of COLMAP has half a pixel more than OpenCV's K: a camera of 240 x 160 has its centre at (120, 80) there, at (119.5, 79.5) here.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check opencv-python-headless==4.14.0.94 pycolmap==4.2.1 numpy==2.4.6
"$folder/venv/bin/python" -W ignore - 2>/dev/null <<'PYTHON'
import cv2
import numpy as np
import pycolmap

u, v = np.meshgrid(np.arange(240), np.arange(160))
off = {name: [] for name in ("blob", "SIFT, precise", "SIFT", "COLMAP's SIFT")}
for middle in ((100, 60), (101, 63), (87, 94)):
    image = (20 + 200 * np.exp(-((u - middle[0]) ** 2 + (v - middle[1]) ** 2) / 72)).astype(np.uint8)
    points = {
        "blob": [point.pt for point in cv2.SimpleBlobDetector_create().detect(255 - image)],
        "SIFT, precise": [point.pt for point in cv2.SIFT_create(enable_precise_upscale=True).detect(image)],
        "SIFT": [point.pt for point in cv2.SIFT_create().detect(image)],
        "COLMAP's SIFT": pycolmap.Sift().extract(image.astype(np.float32) / 255)[0][:, :2],
    }
    for name, found in points.items():
        off[name].append(min((np.array(point) - middle for point in found), key=np.linalg.norm))
for name, wanted in (("blob", 0), ("SIFT, precise", 0), ("SIFT", 0.25), ("COLMAP's SIFT", 0.5)):
    print(f"{name}: {np.round(off[name], 2).tolist()} pixels off")
    assert np.allclose(off[name], wanted, atol=0.04), name
camera = pycolmap.Camera.create_from_model_id(1, pycolmap.CameraModelId.PINHOLE, 500.0, 240, 160)
assert camera.params.tolist() == [500, 500, 120, 80]
PYTHON
