#!/usr/bin/env bash
# Does nuscenes-devkit give radar velocities in the frame of the points when it brings a radar into another sensor's frame?
# Guess: from_file_multisweep turns x, y, z and the velocities alike. Seen with nuscenes-devkit 1.2.0 on 2026-11-28: it turns
# positions only. Of a radar that looks to the left, in the frame of a sensor that looks ahead, a car that drives away to
# the left is 10 m to the left (y), and its vx_comp, vy_comp still say 5 m/s ahead. No word of it in the docstrings: whoever
# joins several radars has to turn columns 6 to 9 with each radar's own rotation.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check nuscenes-devkit==1.2.0
"$folder/venv/bin/python" - "$folder" <<'PYTHON'
import sys
from pathlib import Path

import numpy as np
from nuscenes.utils.data_classes import RadarPointCloud

FIELDS = "x y z dyn_prop id rcs vx vy vx_comp vy_comp is_quality_valid ambig_state x_rms y_rms invalid_state pdh0 vx_rms vy_rms"
KINDS = ["<f4"] * 3 + ["<i1", "<i2"] + ["<f4"] * 5 + ["<i1"] * 8
target = np.zeros(1, list(zip(FIELDS.split(), KINDS)))
# 10 m ahead of the radar, and 5 m/s away from it over ground; the states that the default filters keep.
target["x"], target["vx"], target["vx_comp"] = 10.0, 5.0, 5.0
target["is_quality_valid"], target["ambig_state"] = 1, 3
sizes = " ".join(str(np.dtype(kind).itemsize) for kind in KINDS)
types = " ".join("F" if kind == "<f4" else "I" for kind in KINDS)
header = (
    f"# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS {FIELDS}\nSIZE {sizes}\nTYPE {types}\n"
    f"COUNT {' '.join('1' for _ in KINDS)}\nWIDTH 1\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 1\nDATA binary\n"
)
folder = Path(sys.argv[1])
(folder / "radar.pcd").write_bytes(header.encode() + target.tobytes() + b"\n")


class Tables:
    """The rows of a sample with a radar that looks to the left, and a lidar that looks ahead."""

    dataroot = str(folder)
    rows = {
        "radar": {"filename": "radar.pcd", "ego_pose_token": "pose", "calibrated_sensor_token": "left", "timestamp": 0, "prev": ""},
        "lidar": {"filename": "", "ego_pose_token": "pose", "calibrated_sensor_token": "ahead", "timestamp": 0, "prev": ""},
        "pose": {"translation": [0, 0, 0], "rotation": [1, 0, 0, 0]},
        "left": {"translation": [0, 0, 0], "rotation": [0.5**0.5, 0, 0, 0.5**0.5]},
        "ahead": {"translation": [0, 0, 0], "rotation": [1, 0, 0, 0]},
    }

    def get(self, _table, token):
        return self.rows[token]


sample = {"data": {"RADAR_LEFT": "radar", "LIDAR_TOP": "lidar"}}
cloud, _ = RadarPointCloud.from_file_multisweep(Tables(), sample, "RADAR_LEFT", "LIDAR_TOP", nsweeps=1)
place, velocity = cloud.points[:3, 0], cloud.points[8:10, 0]
print(f"in the frame that looks ahead: x, y = {place[0]:.1f}, {place[1]:.1f} m; vx_comp, vy_comp = {velocity[0]:.1f}, {velocity[1]:.1f} m/s")
assert np.allclose(place, [0.0, 10.0, 0.0], atol=1e-5)
assert np.allclose(velocity, [5.0, 0.0])
PYTHON
