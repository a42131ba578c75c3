#!/usr/bin/env bash
# An IMU turns on the spot at 45 degrees a second for 2 s, sampled at 100 Hz, and Madgwick's filter has its attitude: `Madgwick(frequency=100)`, `update(gyr, acc)`.
# Guess: 90 degrees of yaw. And a compass, on a vehicle that heads for 60 degrees, rolled and pitched by 20, has 60 in each of its functions. Seen with py-imu 0.1.0 on 2026-12-01:
# - yaw stays 0: without `dt=` in each call, the filter begins anew with each sample, from the accelerometer alone, and the gyroscope is never read. The time between samples that
#   was given at the start (`frequency` or `dt`), and is kept, is not read either; with `dt=0.01` in each call it is 89.5
# - the heading is 60 by `accelmag2rpy`, and 56.9 by `rpymag2h` and `qmag2h`, whose tilt compensation rolls and pitches in the other order; at a roll of 30 and a pitch of -20,
#   66.5. Rolled or pitched alone, all three agree
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check py-imu==0.1.0 numpy==2.4.6 scipy==1.17.1 2>/dev/null
cd "$folder"
LOGURU_LEVEL=INFO venv/bin/python - <<'PYTHON'
import numpy as np
from py_imu.fusion.madgwick import Madgwick
from py_imu.fusion.quaternion import Vector3D
from py_imu.fusion.utilities import accelmag2rpy, q2rpy, qmag2h, rpy2q, rpymag2h
from scipy.spatial.transform import Rotation


def yaw_deg(**each_call):
    estimate = Madgwick(frequency=100)
    for _ in range(200):
        attitude = estimate.update(Vector3D(0.0, 0.0, np.radians(45)), Vector3D(0.0, 0.0, 9.81), **each_call)
    assert estimate.dt == 0.01
    return np.degrees(q2rpy(attitude).z)


print(f"yaw: {yaw_deg():.1f}, with dt in each call {yaw_deg(dt=0.01):.1f}")
assert yaw_deg() == 0 and abs(yaw_deg(dt=0.01) - 89.55) < 0.01

for roll, pitch, other in ((20, 0, 60), (0, 20, 60), (20, 20, 56.9), (30, -20, 66.5)):
    body = Rotation.from_euler("ZYX", [60, pitch, roll], degrees=True).inv()  # north, east, down to forward, right, down
    gravity, field = Vector3D(*body.apply([0, 0, 9.81])), Vector3D(*body.apply([20, 0, 45]))
    roll_pitch_yaw = accelmag2rpy(gravity, field)
    attitude = rpy2q(*np.radians([roll, pitch, 60]))
    headings = [np.degrees(each) for each in (roll_pitch_yaw.z, rpymag2h(roll_pitch_yaw, field), qmag2h(attitude, field))]
    print(f"roll {roll}, pitch {pitch}: headings {np.round(headings, 1).tolist()}")
    assert np.allclose(headings, [60, other, other], atol=0.06)
PYTHON
