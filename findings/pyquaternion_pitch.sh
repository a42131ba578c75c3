#!/usr/bin/env bash
# A car heads north (yaw 90 degrees) up a slope of 10 degrees, not rolled; its ego pose is a quaternion, as in nuScenes. What are yaw, pitch and roll?
# Guess: 90, -10, 0 with y to the left (REP 103), by pyquaternion as by all others: its `yaw_pitch_roll` says z-y'-x'' (intrinsic), as ROS has them.
# Seen with pyquaternion 0.9.9, scipy 1.17.1, transforms3d 0.4.2, squaternion 2025.3.2 and numpy-quaternion 2024.0.13 on 2026-11-29:
#   scipy ("ZYX"), transforms3d, squaternion   90, -10, 0
#   pyquaternion                               90, 0, 10: the slope is a roll. They are angles about the axes of the WORLD (z, then y, then x), as
#                                              of "zyx" in small letters for scipy: pitch and roll of a car that heads east are right, of one
#                                              that heads north exchanged, and of one that heads north-east mixed (-7.1 and 7.1)
#   numpy-quaternion, `as_euler_angles`        z-y-z: for a yaw of 90, a pitch of 20 and a roll of 30 it says 30.6, 35.5, 53.9
# The yaw of pyquaternion is no heading, either: 45.4 for 45 on that slope. `quaternion_yaw` of nuscenes-devkit turns an x axis and is right.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check --no-deps \
  pyquaternion==0.9.9 scipy==1.17.1 transforms3d==0.4.2 squaternion==2025.3.2 numpy-quaternion==2024.0.13 numpy==2.4.6
"$folder/venv/bin/python" - <<'PYTHON'
import numpy as np
import pyquaternion
import quaternion
import squaternion
import transforms3d
from scipy.spatial.transform import Rotation


def angles(yaw, pitch, roll):
    """Return what each library says of this attitude (degrees; about z, then the new y, then the new x)."""
    rotation = Rotation.from_euler("ZYX", (yaw, pitch, roll), degrees=True)
    x, y, z, w = rotation.as_quat()
    seen = {
        "scipy ZYX": rotation.as_euler("ZYX"),
        "scipy zyx": rotation.as_euler("zyx"),
        "transforms3d": transforms3d.euler.quat2euler((w, x, y, z))[::-1],
        "squaternion": squaternion.Quaternion(w, x, y, z).to_euler()[::-1],
        "pyquaternion": pyquaternion.Quaternion(w, x, y, z).yaw_pitch_roll,
        "numpy-quaternion": quaternion.as_euler_angles(np.quaternion(w, x, y, z)),
    }
    return {name: np.degrees(np.array(value, float)).round(1) + 0.0 for name, value in seen.items()}


NORTH_UP, EAST_UP, NORTH_EAST_UP, ROLLED = (90, -10, 0), (0, -10, 0), (45, -10, 0), (90, 20, 30)
for attitude in (NORTH_UP, EAST_UP, NORTH_EAST_UP, ROLLED):
    seen = angles(*attitude)
    print(attitude, {name: value.tolist() for name, value in seen.items()})
    for name in ("scipy ZYX", "transforms3d", "squaternion"):
        assert np.allclose(seen[name], attitude, atol=0.05)
    assert np.allclose(seen["pyquaternion"], seen["scipy zyx"], atol=0.05)
assert angles(*NORTH_UP)["pyquaternion"].tolist() == [90, 0, 10]
assert angles(*EAST_UP)["pyquaternion"].tolist() == [0, -10, 0]
assert np.allclose(angles(*NORTH_EAST_UP)["pyquaternion"], [45.4, -7.1, 7.1], atol=0.05)
assert np.allclose(angles(*ROLLED)["numpy-quaternion"], [30.6, 35.5, 54], atol=0.11)
PYTHON
