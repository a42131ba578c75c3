#!/usr/bin/env bash
# Clouds of a drive are joined in one LAS file: the first is written, the others are appended. LAS keeps coordinates as integers, with a
# scale and an offset in the header of the file, and each cloud has its own. What becomes of points with another scale?
# Guess: laspy turns them into the scale of the file, as it does when it writes a file, or refuses.
# Seen with laspy 2.7.0 on 2026-11-28: `write_points` does; `append_points` takes the integers as they are, without a word. Points at 1, 2
# and 3 m, in millimetres, come back at 110, 120 and 130 m from a file in centimetres whose offset is 100 m.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check laspy==2.7.0 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import laspy
import numpy as np


def header(scale, offset):
    made = laspy.LasHeader(point_format=3, version="1.2")
    made.scales, made.offsets = np.full(3, scale), np.array([offset, 0.0, 0.0])
    return made


def cloud(made, x):
    points = laspy.LasData(made)
    points.x = points.y = points.z = np.array(x)
    return points


later = cloud(header(0.001, 0.0), [1.0, 2.0, 3.0])
cloud(header(0.01, 100.0), [101.0, 102.0]).write("map.las")
with laspy.open("map.las", "a") as file:
    file.append_points(later.points)
with laspy.open("written.las", "w", header=header(0.01, 100.0)) as file:
    file.write_points(later.points)
appended, written = np.array(laspy.read("map.las").x), np.array(laspy.read("written.las").x)
print("appended:", appended, "written:", written)
assert np.allclose(written, [1, 2, 3])
assert np.allclose(appended, [101, 102, 110, 120, 130])
PYTHON
