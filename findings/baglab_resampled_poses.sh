#!/usr/bin/env bash
# A table of a vehicle's poses has quaternions, its yaw, a mode and a flag; localisation publishes q or -q as it comes, which is one orientation. The table is brought
# to a steady rate, and onto the times of another topic, with baglab, which has SLERP, too. What is half-way between two poses that are alike?
# Guess: the same pose, by SLERP; a mode and a flag that were there. Seen with baglab 1.1.0 on 2026-11-29, without a word, by `resample` and by `align_time`:
# - quaternions are interpolated number by number, as its documentation says of all that is numeric: (0, 0, 0, 0) half-way, and half as long at a quarter
# - a yaw that goes from 3.1 to -3.1 rad, 5 degrees, looks backwards half-way
# - between mode 1 and mode 5 there is a mode 3; only the flag, no number to pandas, is held
# - a pause of five seconds is a line like any other stretch
# `interp_pose` is right: its SLERP takes the shorter arc.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check baglab==1.1.0 pandas==3.1.1 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import baglab
import numpy as np
import pandas as pd

Z, W = np.sin(0.2), np.cos(0.2)
poses = pd.DataFrame(
    {
        "position.x": [0.0, 5.0],
        "position.y": [0.0, 0.0],
        "orientation.x": [0.0, -0.0],
        "orientation.y": [0.0, -0.0],
        "orientation.z": [Z, -Z],
        "orientation.w": [W, -W],
        "yaw": [3.1, -3.1],
        "mode": np.array([1, 5], np.uint8),
        "localized": [True, False],
    },
    index=[0.0, 5.0],
)
xyzw = [f"orientation.{axis}" for axis in "xyzw"]
other = pd.DataFrame({"speed": [1.0, 1.0, 1.0]}, index=[0.0, 2.5, 5.0])
for name, table in (("resample", baglab.resample(poses, 1.25)), ("align_time", baglab.align_time(poses, other)[0])):
    half_way = table.loc[2.5]
    print(f"{name}: {half_way.to_dict()}")
    assert np.allclose(half_way[xyzw].astype(float), 0)
    assert (half_way["yaw"], half_way["mode"], half_way["localized"], half_way["position.x"]) == (0, 3, True, 2.5)
quarter = baglab.resample(poses, 1.25).loc[1.25]
assert np.isclose(np.linalg.norm(quarter[xyzw].astype(float)), 0.5)
assert np.allclose(baglab.interp_pose(poses, [2.5])[xyzw], [[0, 0, Z, W]])
PYTHON
