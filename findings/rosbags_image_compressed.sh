#!/usr/bin/env bash
# What does rosbags-image make of compressed images that are no 8-bit colours: depth in millimetres as a 16-bit PNG (`16UC1; png
# compressed`), and a Bayer mosaic (`bayer_rggb8; jpeg compressed bayer_rggb8`), as image_transport writes them for such cameras?
# Guess: the depth as uint16; of the mosaic the colours if one asks for bgr8, as of the same image without compression; or an error.
# Seen with rosbags-image 0.10.4 on 2026-11-28: it does not look at `format`, without a word. 1500 mm are 5 (the upper 8 bits of 16); no
# argument gives the depth. Of a red mosaic, bgr8 is the mosaic itself, (H, W), and rgb8 is grey with the mosaic's pattern.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check \
  rosbags-image==0.10.4 rosbags==0.11.9 numpy==2.4.6 opencv-python-headless==4.14.0.94
cd "$folder"
venv/bin/python - <<'PYTHON'
import cv2
import numpy as np
from rosbags.image import message_to_cvimage
from rosbags.typesys import Stores, get_typestore

types = get_typestore(Stores.ROS2_HUMBLE).types
header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](0, 0), "camera")


def compressed(form, suffix, pixels):
    data = cv2.imencode(suffix, pixels)[1].reshape(-1)
    return types["sensor_msgs/msg/CompressedImage"](header, form, data)


depth = message_to_cvimage(compressed("16UC1; png compressed ", ".png", np.full((4, 4), 1500, np.uint16)))
print(f"1500 mm: {depth.dtype} {depth[0, 0]}")
assert (depth.dtype, depth[0, 0]) == (np.uint8, 1500 >> 8)

mosaic = np.zeros((16, 16), np.uint8)
mosaic[::2, ::2] = 200  # red pixels of rggb
plain = types["sensor_msgs/msg/Image"](header, 16, 16, "bayer_rggb8", 0, 16, mosaic.reshape(-1))
colours = message_to_cvimage(plain, "bgr8")
packed = compressed("bayer_rggb8; png compressed bayer_rggb8", ".png", mosaic)
bgr, rgb = message_to_cvimage(packed, "bgr8"), message_to_cvimage(packed, "rgb8")
print(f"mosaic: plain {colours[8, 8]}, compressed bgr8 {bgr.shape}, rgb8 {rgb[8, 8]} beside {rgb[9, 9]}")
assert colours[8, 8].tolist() == [0, 0, 200]
assert np.array_equal(bgr, mosaic)
assert rgb[8, 8].tolist() == [200, 200, 200] and rgb[9, 9].tolist() == [0, 0, 0]
PYTHON
