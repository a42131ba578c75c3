#!/usr/bin/env bash
# What becomes of an orientation whose quaternion is (0, 0, 0, 0), as localisation nodes publish before they have one?
# Guess: every library refuses it. Seen on 2026-11-28, Python 3.11:
#   scipy 1.17.1, spatialmath-python 1.1.18   refuse it (scipy: the whole array for one bad row)
#   evo 1.38.1, transforms3d 0.4.2, pytransform3d 3.17.0   take it for no rotation at all, without a word
#   pyquaternion 0.9.9 (what nuscenes-devkit uses)   a matrix of zeros: every point lands on the origin, without a word
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check numpy==2.4.6 scipy==1.17.1 pyquaternion==0.9.9 \
  evo==1.38.1 transforms3d==0.4.2 pytransform3d==3.17.0 spatialmath-python==1.1.18
"$folder/venv/bin/python" - <<'PYTHON'
import evo.core.transformations
import numpy as np
import pytransform3d.rotations
import transforms3d.quaternions
from pyquaternion import Quaternion
from scipy.spatial.transform import Rotation
from spatialmath import UnitQuaternion

ZERO, IDENTITY = [0.0, 0.0, 0.0, 0.0], np.eye(3)
expected = {
    "scipy": (lambda: Rotation.from_quat([ZERO, [0.0, 0.0, 0.0, 1.0]]).as_matrix(), None),
    "spatialmath-python": (lambda: UnitQuaternion(ZERO).R, None),
    "evo": (lambda: evo.core.transformations.quaternion_matrix(ZERO)[:3, :3], IDENTITY),
    "transforms3d": (lambda: transforms3d.quaternions.quat2mat(ZERO), IDENTITY),
    "pytransform3d": (lambda: pytransform3d.rotations.matrix_from_quaternion(ZERO), IDENTITY),
    "pyquaternion": (lambda: Quaternion(ZERO).rotation_matrix, np.zeros((3, 3))),
}
changed = []
for name, (rotation_of, matrix) in expected.items():
    try:
        got = np.asarray(rotation_of())
    except ValueError as error:
        got = None
        print(f"{name}: refuses it: {error}")
    else:
        print(f"{name}: {got.tolist()}")
    if (got is None) != (matrix is None) or (matrix is not None and not np.array_equal(got, matrix)):
        changed.append(name)
raise SystemExit(f"no longer so: {', '.join(changed)}" if changed else 0)
PYTHON
