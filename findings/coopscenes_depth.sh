#!/usr/bin/env bash
# A stereo camera of a vehicle (500 pixels of focal length, 0.2 m wide) sees a wall 5 m away, so that the right image is the left one, moved by 20 pixels. Depth is computed
# with the devkit of CoopScenes (`get_depth_map`, "experimental"); its lens has five coefficients (k1, k2, p1, p2, k3), the last of which is 0.2.
# Guess: 5 m; images are rectified by all five. Seen with CoopScenes 0.9.4 and opencv-python 5.0.0.93 on 2026-11-29, without a word:
# - 0.31 m, a sixteenth: disparities of OpenCV's StereoSGBM are integers, in sixteenths of a pixel, and are taken for pixels
# - with another focal length after rectification than before (P of 400 pixels, K of 500) depth is by that of before: 25 % off
# - a rectified image (`get_rect_img`, `Camera.image`) is the same with k3 = 0.2 and with k3 = 0: the last coefficient is left out
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3.11 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check CoopScenes==0.9.4 kiss-icp==1.2.0 opencv-python==5.0.0.93 numpy==2.4.6 scipy==1.17.1
cd "$folder"
venv/bin/python - <<'PYTHON'
import cv2
import numpy as np
from coopscenes.data import Camera, CameraInformation, Image
from coopscenes.utils import get_depth_map, get_rect_img
from PIL import Image as Picture

FOCAL_PX, WIDTH_M, DISPARITY_PX = 500.0, 0.2, 20


def camera(name, pixels, new_focal_px=FOCAL_PX, k3=0.0):
    """Return a camera of the devkit with an image."""
    matrix = np.array([[FOCAL_PX, 0, 200], [0, FOCAL_PX, 100], [0, 0, 1]])
    new_matrix = matrix * [[new_focal_px / FOCAL_PX, 1, 1], [1, new_focal_px / FOCAL_PX, 1], [1, 1, 1]]
    stereo = np.eye(4)
    stereo[0, 3] = WIDTH_M
    info = CameraInformation(
        name, shape=(400, 200), camera_mtx=matrix, distortion_mtx=np.array([0, 0, 0, 0, k3]), rectification_mtx=np.eye(3),
        projection_mtx=new_matrix, stereo_transform=stereo,
    )  # fmt: skip
    return Camera(info, Image(Picture.fromarray(pixels)))


wall = cv2.GaussianBlur(np.random.default_rng(0).integers(0, 256, (200, 500, 3), dtype=np.uint8), (5, 5), 0)
left, right = wall[:, :400].copy(), wall[:, DISPARITY_PX : 400 + DISPARITY_PX].copy()
for new_focal_px, disparity_px in ((FOCAL_PX, 20), (400.0, 16)):
    depth_m = get_depth_map(camera("left", left, new_focal_px), camera("right", right, new_focal_px))
    middle_m = np.median(depth_m[60:140, 200:300])
    print(f"focal length of {new_focal_px:.0f} pixels after rectification: {middle_m:.3f} m; 5 m is right")
    assert abs(middle_m - FOCAL_PX * WIDTH_M / disparity_px / 16) < 0.01

bent, straight = (np.array(get_rect_img(camera("left", left, k3=k3)).image) for k3 in (0.2, 0.0))
assert np.array_equal(bent, straight)
PYTHON
