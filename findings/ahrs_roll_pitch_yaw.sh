#!/usr/bin/env bash
# A vehicle is rolled by 0.3 rad, not pitched, not turned. ahrs has two classes that take `rpy`: Quaternion and DCM, a matrix. Is it one rotation?
# Guess: yes, and both give (0.3, 0, 0) back. Seen with AHRS 0.4.0 on 2026-11-29, without a word:
# - the quaternion rolls by 0.3, and gives (0.3, 0, 0) back (`to_angles`)
# - the matrix TURNS by 0.3, about z: its `rpy` are yaw, pitch, roll. And what it gives back of itself (`to_rpy`, `to_angles`) is (0, 0, -0.3)
# - of the matrix that the quaternion becomes (`to_DCM`), which is right, `to_rpy` has (-0.3, 0, 0): the signs are those of the inverse
# For a drive on a plane, where roll and pitch are small, headings are in the roll, or count backwards. `DCM(x=…, y=…, z=…)` has a third meaning:
# about x first, and then about axes that have turned along.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check AHRS==0.4.0 numpy==2.4.6
"$folder/venv/bin/python" - <<'PYTHON'
import numpy as np
from ahrs import DCM, Quaternion

ANGLE = 0.3
COS, SIN = np.cos(ANGLE), np.sin(ANGLE)
ROLLED = np.array([[1, 0, 0], [0, COS, -SIN], [0, SIN, COS]])
TURNED = np.array([[COS, -SIN, 0], [SIN, COS, 0], [0, 0, 1]])

quaternion, matrix = Quaternion(rpy=[ANGLE, 0, 0]), DCM(rpy=[ANGLE, 0, 0])
print(f"Quaternion: {quaternion.to_DCM().round(3).tolist()}, back {np.round(quaternion.to_angles(), 3)}, "
      f"and by its matrix {np.round(DCM(quaternion.to_DCM()).to_rpy(), 3)}")
print(f"DCM: {np.round(matrix, 3).tolist()}, back {np.round(matrix.to_rpy(), 3)}")
assert np.allclose(quaternion.to_DCM(), ROLLED) and np.allclose(quaternion.to_angles(), [ANGLE, 0, 0])
assert np.allclose(matrix, TURNED)
assert np.allclose(matrix.to_rpy(), [0, 0, -ANGLE]) and np.allclose(matrix.to_angles(), [0, 0, -ANGLE])
assert np.allclose(DCM(quaternion.to_DCM()).to_rpy(), [-ANGLE, 0, 0])

roll, pitch, yaw = 0.1, 0.2, 0.3
third, right = DCM(x=roll, y=pitch, z=yaw), Quaternion(rpy=[roll, pitch, yaw]).to_DCM()
about_x, about_y, about_z = (np.array(DCM(**{axis: angle})) for axis, angle in zip("xyz", (roll, pitch, yaw)))
assert np.allclose(right, about_z @ about_y @ about_x) and np.allclose(third, about_x @ about_y @ about_z)
PYTHON
