#!/usr/bin/env bash
# A fisheye camera says in its CameraInfo how it distorts: `distortion_model` "equidistant", with four coefficients. What does ROS' own
# camera model, image_geometry, make of it in Python? Guess: the equidistant model, or an error.
# Seen with image_geometry 1.16.2 of Debian 12 and opencv-python-headless 4.14.0.94 on 2026-11-29: `distortion_model` is never read. The
# coefficients are taken for k1, k2, p1, p2 of the polynomial ("plumb_bob"), which are four as well: 9 pixels off at a quarter of the way
# to the border, 474 near it, without a word; `rectifyImage` likewise, so that what is rectified is as bent as before. ROS 2's has the same
# source.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check opencv-python-headless==4.14.0.94 numpy==2.4.6 PyYAML==6.0.3
cd "$folder"
apt-get download --quiet=2 -o APT::Sandbox::User=root python3-image-geometry=1.16.2+ds-1 python3-sensor-msgs python3-std-msgs \
  python3-geometry-msgs python3-genpy python3-genmsg
for package in *.deb; do dpkg --extract "$package" debian; done
PYTHONPATH=debian/usr/lib/python3/dist-packages venv/bin/python - <<'PYTHON'
import cv2
import numpy as np
from image_geometry import PinholeCameraModel
from sensor_msgs.msg import CameraInfo

K = np.array([[400.0, 0.0, 640.0], [0.0, 400.0, 400.0], [0.0, 0.0, 1.0]])
D = [0.01, -0.02, 0.003, -0.0005]
info = CameraInfo(width=1280, height=800, distortion_model="equidistant", D=D, K=K.ravel().tolist(), R=np.eye(3).ravel().tolist())
info.P = np.hstack([K, np.zeros((3, 1))]).ravel().tolist()
model = PinholeCameraModel()
model.fromCameraInfo(info)
off = []
for u in (640, 800, 1100):
    pixel = np.array([[[u, 400.0]]])
    right, polynomial = (undistort(pixel, K, np.array(D), P=K)[0, 0] for undistort in (cv2.fisheye.undistortPoints, cv2.undistortPoints))
    got = model.rectifyPoint((u, 400.0))
    off.append(float(np.linalg.norm(got - right)))
    print(f"({u}, 400) is {np.round(got, 1)} rectified, {np.round(right, 1)} would be right")
    assert np.allclose(got, polynomial, atol=1e-6)
assert np.allclose(off, [0.0, 9.0, 473.9], atol=0.1), off
PYTHON
