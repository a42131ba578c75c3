#!/usr/bin/env bash
# A scan is written with laspy into a new LAS file, x in a UTM zone, intensities from 0 to 1 as the lidar gave them, scan angles of -30 to 45
# degrees, in format 3; then it is converted to format 6, which LAS 1.4 and COPC want. One point is lost (NaN). What is in the files?
# Guess: coordinates to the millimetre; intensities refused or scaled; angles in the new format's unit. Seen with laspy 2.7.0 on 2026-11-29:
# - centimetres: a new file has steps of 0.01 m unless one says otherwise
# - intensities are all 0, cut off to integers, without a word
# - after `laspy.convert` all scan angles are 0, and back in format 3, too, without a word: the field has another name in format 6
# - NaN is a point 21,474,836.48 m to the west (NumPy warns); what is too large is refused
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check laspy==2.7.0 numpy==2.4.6
cd "$folder"
venv/bin/python -W ignore - <<'PYTHON'
import laspy
import numpy as np

las = laspy.create(point_format=3)
las.x = np.array([691607.123456, 691608.5, np.nan])
las.y = las.z = np.zeros(3)
las.intensity = np.array([0.2, 0.9, 0.5])
las.scan_angle_rank = np.array([-30, 0, 45], "int8")
las.write("scan.las")
scan = laspy.read("scan.las")
converted = laspy.convert(scan, point_format_id=6)
back = laspy.convert(converted, point_format_id=3)
x, intensity, angles = (np.asarray(scan[name]) for name in ("x", "intensity", "scan_angle_rank"))
print(f"x {x}, intensity {intensity}, angles {angles}")
print(f"converted: {np.asarray(converted.scan_angle)}, and back: {np.asarray(back.scan_angle_rank)}")
assert np.allclose(x[:2], [691607.12, 691608.5], atol=1e-6) and np.isclose(x[2], -21474836.48)
assert np.all(intensity == 0)
assert angles.tolist() == [-30, 0, 45]
assert np.all(np.asarray(converted.scan_angle) == 0) and np.all(np.asarray(back.scan_angle_rank) == 0)
PYTHON
