#!/usr/bin/env bash
# A stereo camera, 0.1 m wide, 1000 pixels of focal length, sends its images binned by 2 x 2; CameraInfo is that of the full images, and says `binning_x` and `binning_y`
# 2, as ROS has it. How far is what has a disparity of 10 pixels in these images, by ROS' own camera model in Python, image_geometry?
# Guess: 5 m, as 500 pixels * 0.1 m / 10 pixels. Seen with image_geometry 1.16.2 of Debian 12 on 2026-11-29, without a word:
# - 10 m (`getZ`): focal length and centre are divided by the binning, P[0, 3] (minus focal length times base) is not. A point at 5 m is projected into the right image
#   20 pixels to the left of where the left one has it (`project3dToPixel`, `getDisparity`), as in the full images
# - the field of view (`fovX`) is 104 degrees in place of 65: the full width by the binned focal length
# ROS 2's has the same lines for K and P in its source.
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
import math

import numpy as np
from image_geometry import StereoCameraModel
from sensor_msgs.msg import CameraInfo


def model(binning):
    """Return the model of the stereo camera with images that are binned so."""
    infos = []
    for tx in (0.0, -100.0):  # minus focal length times base
        info = CameraInfo(width=1280, height=800, distortion_model="plumb_bob", D=[0.0] * 5, binning_x=binning, binning_y=binning)
        info.K = [1000.0, 0.0, 640.0, 0.0, 1000.0, 400.0, 0.0, 0.0, 1.0]
        info.R = np.eye(3).ravel().tolist()
        info.P = [1000.0, 0.0, 640.0, tx, 0.0, 1000.0, 400.0, 0.0, 0.0, 0.0, 1.0, 0.0]
        infos.append(info)
    stereo = StereoCameraModel()
    stereo.fromCameraInfo(*infos)
    return stereo


for binning, far_m, disparity, fov_deg in ((1, 10, 20, 65.2), (2, 10, 20, 104.0)):
    stereo = model(binning)
    left, right = stereo.project3dToPixel((0.5, 0.0, 5.0))
    print(f"binned by {binning}: 10 pixels are {stereo.getZ(10)} m; at 5 m left {left}, right {right}; {math.degrees(stereo.left.fovX()):.1f} degrees")
    assert np.allclose(left, (740 / binning, 400 / binning))
    assert stereo.getZ(10) == far_m and left[0] - right[0] == stereo.getDisparity(5.0) == disparity
    assert abs(math.degrees(stereo.left.fovX()) - fov_deg) < 0.1
PYTHON
