#!/usr/bin/env bash
# Roll, pitch and yaw of an aircraft are given to quat-numpy, whose `Quaternion.from_euler` takes "(roll, pitch, yaw)", and shows a yaw of 90 degrees: `from_euler((0, 0, np.pi/2))  # yaw 90 deg
# about z`, with (0.707, 0, 0, 0.707) as its result. Guess: that. Seen with quat-numpy 0.2.0 on 2026-11-30: (0.707, 0.707, 0, 0), a roll. Angles are taken in the order of the sequence, which is "zyx"
# as it is set up, so the first one, called roll, is a yaw. `to_euler` gives back the numbers that went in, so that going there and back shows nothing.
# An aircraft that is banked by 30 degrees in level flight, in a heading of 90, is banked by 90 and heads for 30; in the order (yaw, pitch, roll), or with `seq="xyz", intrinsic=False`, it is right.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check quat-numpy==0.2.0 scipy==1.17.1 numpy==2.4.6 2>/dev/null
venv/bin/python - <<'PYTHON'
import numpy as np
from quat import Quaternion
from scipy.spatial.transform import Rotation

assert "(roll, pitch, yaw)" in Quaternion.from_euler.__doc__ and "yaw 90" in Quaternion.from_euler.__doc__


def numbers(quaternion):
    return np.array([quaternion.r, quaternion.i, quaternion.j, quaternion.k])


yawed = numbers(Quaternion.from_euler((0, 0, np.pi / 2)))
print("yaw of 90 degrees, by its documentation:", yawed.round(3))
assert np.allclose(yawed, [0.5**0.5, 0.5**0.5, 0, 0])
banked = np.radians([30, 0, 90])
made = Quaternion.from_euler(banked)
angles = Rotation.from_quat(numbers(made), scalar_first=True).as_euler("xyz", degrees=True)
print("roll 30, pitch 0, yaw 90 are roll, pitch, yaw", angles.round(1), "and back", np.degrees(made.to_euler()).round(1))
assert np.allclose(angles, [90, 0, 30]) and np.allclose(made.to_euler(), banked)
true = Rotation.from_euler("xyz", banked).as_quat(scalar_first=True)
for right in (Quaternion.from_euler(banked[::-1]), Quaternion.from_euler(banked, seq="xyz", intrinsic=False)):
    assert np.isclose(abs(numbers(right) @ true), 1)
PYTHON
