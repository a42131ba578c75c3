#!/usr/bin/env bash
# A car climbs a hill of 8 degrees, to the east, north, west and south. py123d, which converts driving datasets into one format of its own, has its pose as a
# quaternion. What are its pitch and roll? Guess: pitch -8 degrees, nose up, each time; "the rotation order is intrinsic Z-Y'-X''", its help says.
# Seen with py123d 0.7.0 on 2026-11-30, without a word: so it is by `EulerAngles.from_rotation_matrix` alone. By `pose.pitch`, `roll`, `yaw` and
# `quaternion.euler_angles`, the order is X-Y'-Z'': to the north it rolls by 8 degrees and does not climb, to the west it drives downhill. A pose from these
# angles, which take Z-Y'-X'', is another one. With 3 degrees of bank, to the north-east, the heading of `pose_se2` is half a degree off: 0.4 m at 50 m
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check --no-deps py123d==0.7.0 numpy==2.4.6 pyquaternion==0.9.9 scipy==1.17.1 shapely==2.2.0 typing_extensions==4.16.0 2>/dev/null
cd "$folder"
venv/bin/python - <<'PYTHON'
import numpy as np
from py123d.geometry import EulerAngles, PoseSE3

HILL = np.radians(-8)


def pose_of(roll, pitch, yaw):
    """Return the pose of a car, by its matrix: turned by yaw, then by pitch about its new y axis, then by roll about its x axis."""
    (cr, cp, cy), (sr, sp, sy) = np.cos((roll, pitch, yaw)), np.sin((roll, pitch, yaw))
    about_z, about_y = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]]), np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    return PoseSE3.from_R_t(about_z @ about_y @ np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]]), np.zeros(3))


for way, degrees, pitch, roll in (("east", 0, -8, 0), ("north", 90, 0, 8), ("west", 180, 8, 0), ("south", -90, 0, -8)):
    pose = pose_of(0, HILL, np.radians(degrees))
    by_matrix = np.degrees(EulerAngles.from_rotation_matrix(pose.rotation_matrix).array)
    again = PoseSE3.from_R_t(pose.euler_angles, np.zeros(3))
    climbs = [round(float(np.degrees(np.arcsin(of.rotation_matrix[2, 0]))), 3) + 0.0 for of in (pose, again)]
    seen = np.degrees((pose.pitch, pose.roll)).round(3) + 0.0
    print(f"{way}: pitch {seen[0]}, roll {seen[1]}; by its matrix {by_matrix[1]:.3f} and {by_matrix[0]:.3f}; climbs {climbs[0]}, made again of its angles {climbs[1]}")
    assert np.allclose(seen, (pitch, roll)) and np.allclose(by_matrix[:2], (0, -8))
    assert climbs[0] == 8 and np.isclose(climbs[1], -pitch)

pose = pose_of(np.radians(3), HILL, np.radians(45))
forward = pose.rotation_matrix[:2, 0]
true, seen = np.degrees(np.arctan2(forward[1], forward[0])), np.degrees(pose.pose_se2.yaw)
print(f"heading {true:.2f}, pose_se2 {seen:.2f} degrees")
assert np.isclose(true, 45) and 0.4 < seen - true < 0.5
PYTHON
