#!/usr/bin/env bash
# An extrinsic calibration mirrors an axis (y to the right), as of a sensor with left-handed coordinates. What becomes of its matrix,
# whose determinant is -1, on the way to a quaternion? Guess: every library refuses it, as no rotation does that.
# Seen on 2026-11-28, for diag(1, -1, 1):
#   pyquaternion 0.9.9, pytransform3d 3.17.0, scipy 1.17.1   refuse it
#   transforms3d 0.4.2   half a turn about x, (0, 1, 0, 0), without a word: z points down as well; `mat2euler` says no rotation at all
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check transforms3d==0.4.2 pyquaternion==0.9.9 pytransform3d==3.17.0 scipy==1.17.1 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import numpy as np
import pytransform3d.rotations
import transforms3d
from pyquaternion import Quaternion
from scipy.spatial.transform import Rotation

MIRROR = np.diag([1.0, -1.0, 1.0])
refused = []
for name, convert in {
    "pyquaternion": lambda: Quaternion(matrix=MIRROR),
    "pytransform3d": lambda: pytransform3d.rotations.quaternion_from_matrix(MIRROR),
    "scipy": lambda: Rotation.from_matrix(MIRROR),
}.items():
    try:
        print(f"{name}: {convert()}")
    except ValueError as error:
        refused.append(name)
        print(f"{name} refuses it: {error}")
quaternion, angles = transforms3d.quaternions.mat2quat(MIRROR), transforms3d.euler.mat2euler(MIRROR)
print("transforms3d:", quaternion, angles)
same = np.array_equal(np.abs(quaternion), [0, 1, 0, 0]) and not np.any(angles)
raise SystemExit(0 if len(refused) == 3 and same else "no longer so")
PYTHON
