#!/usr/bin/env bash
# An IMU with a magnetometer stands still: 30 degrees turned about the vertical, counted from north to west, then rolled by 20. Its z axis
# points up, so it measures +9.81 m/s2 there (REP 145). What do the filters of one library, ahrs, say of it?
# Guess: the same, up to noise. Seen with AHRS 0.4.0 on 2026-11-28, yaw, pitch, roll in degrees, all as they are set up:
#   Madgwick, Complementary, Tilt, FAMC, Fourati   (30, 0, 20): x north, y west, z up
#   Mahony        (120, 0, 20): x east, y north, z up
#   AQUA, SAAM    (-28.5, -9.8, -17.5): the inverse, from the world into the sensor
#   FQA           about (-27, 0, -160): upside down
# All are attributes `Q` of the same name and shape, so whoever changes the filter turns the trajectory, without an error.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check AHRS==0.4.0 scipy==1.17.1 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import ahrs
import numpy as np
from scipy.spatial.transform import Rotation

NUMBER = 20_000  # filters that start elsewhere need time to settle
nwu_Q_imu = Rotation.from_euler("ZYX", [30, 0, 20], degrees=True)
still = {
    "acc": np.tile(nwu_Q_imu.inv().apply([0, 0, 9.81]), (NUMBER, 1)),
    "mag": np.tile(nwu_Q_imu.inv().apply([20, 0, -40]), (NUMBER, 1)),  # north, and down into the ground
}
RIGHT, INVERSE = (30, 0, 20), tuple(nwu_Q_imu.inv().as_euler("ZYX", degrees=True))
EXPECTED = {
    "Madgwick": RIGHT, "Complementary": RIGHT, "Tilt": RIGHT, "FAMC": RIGHT, "Fourati": RIGHT,
    "Mahony": (120, 0, 20), "AQUA": INVERSE, "SAAM": INVERSE, "FQA": (-26.7, 0, -160),
}
for name, expected in EXPECTED.items():
    given = dict(still)
    if name in {"Madgwick", "Complementary", "Fourati", "Mahony", "AQUA"}:
        given["gyr"] = np.zeros((NUMBER, 3))
    else:
        given = {key: values[:2] for key, values in given.items()}
    w, x, y, z = getattr(ahrs.filters, name)(**given).Q[-1]
    angles = Rotation.from_quat([x, y, z, w]).as_euler("ZYX", degrees=True)
    print(f"{name}: yaw, pitch, roll {np.round(angles, 1)}")
    assert np.allclose(angles, expected, atol=0.2), expected
PYTHON
