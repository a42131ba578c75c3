#!/usr/bin/env bash
# A camera is calibrated with a model of Bundler (as Structure from Motion and the BAL datasets have it): focal length 500 pixels, k1 = 0.1, k2 = 0.01. A ray (0.3, 0.4) becomes
# a pixel with gtsam, by the calibration (`uncalibrate`) and by a camera that has it (`project`), and the pixel becomes a ray again (`calibrate`).
# Guess: at (473.8, 445.1), by both, and the ray. Seen with gtsam 4.3.0 on 2026-11-29, in Python, without a word:
# - `Cal3Bundler.uncalibrate` has no distortion: (470, 440), 6.4 pixels off; nor has `calibrate`, so that there and back nothing shows. The camera has it
# - `vector()` is (500, 500, 0, 320, 240), without k1 and k2, of which `print` tells; and so is that of `Cal3Fisheye`, whose pixels are right
# Both classes answer as the one they are derived from. `Cal3DS2`, with the same k1 and k2, is right in all of it.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check gtsam==4.3.0 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import gtsam
import numpy as np

FOCAL, K1, K2, CENTRE = 500.0, 0.1, 0.01, (320.0, 240.0)
ray = np.array([0.3, 0.4])
r2 = ray @ ray
right = FOCAL * ray * (1 + K1 * r2 + K2 * r2**2) + CENTRE

bundler = gtsam.Cal3Bundler(FOCAL, K1, K2, *CENTRE)
camera = gtsam.PinholeCameraCal3Bundler(gtsam.Pose3(), bundler)
by_calibration, by_camera = bundler.uncalibrate(ray), camera.project(np.array([*ray, 1.0]))
print(f"right {right}, by the calibration {by_calibration}, by the camera {by_camera}; vector {bundler.vector()}\n{bundler}")
assert np.allclose(by_camera, right)
assert np.allclose(by_calibration, FOCAL * ray + CENTRE)
assert np.allclose(bundler.calibrate(right), (right - CENTRE) / FOCAL) and not np.allclose(bundler.calibrate(right), ray, atol=0.005)
assert bundler.vector().tolist() == [FOCAL, FOCAL, 0, *CENTRE]

polynomial = gtsam.Cal3DS2(FOCAL, FOCAL, 0, *CENTRE, K1, K2, 0, 0)
assert np.allclose(polynomial.uncalibrate(ray), right) and np.allclose(polynomial.calibrate(right), ray, atol=1e-6)
assert len(polynomial.vector()) == 9

fisheye = gtsam.Cal3Fisheye(FOCAL, FOCAL, 0, *CENTRE, K1, K2, 0, 0)
theta = np.arctan(np.hypot(*ray))
bent = FOCAL * ray / np.hypot(*ray) * theta * (1 + K1 * theta**2 + K2 * theta**4) + CENTRE
print(f"fisheye: {fisheye.uncalibrate(ray)}, vector {fisheye.vector()}")
assert np.allclose(fisheye.uncalibrate(ray), bent)
assert len(fisheye.vector()) == 5
PYTHON
