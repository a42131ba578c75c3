#!/usr/bin/env bash
# Two headings, 170 and -170 degrees, are 20 degrees apart. What is half-way between them, and how far apart are they, as matrices and as unit quaternions of
# spatialmath, which has the same methods for both?
# Guess: 180 degrees; 20 degrees. Seen with spatialmath-python 1.1.18 on 2026-11-29, without a word:
# - `SO3.interp` and `SE3.interp`: 180 degrees; `UnitQuaternion.interp`: 0 degrees, backwards, unless it is told `shortest=True`
# - `SO3.angdist`: 20 degrees; `UnitQuaternion.angdist`: 10, the angle between the quaternions, unless it is told `metric=4`. Each has defaults of its own
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check spatialmath-python==1.1.18
"$folder/venv/bin/python" - <<'PYTHON'
from math import degrees

from spatialmath import SE3, SO3, UnitQuaternion

half_way, apart = {}, {}
for kind in (SO3, SE3, UnitQuaternion):
    first, second = kind.Rz(170, unit="deg"), kind.Rz(-170, unit="deg")
    half_way[kind.__name__] = round(abs(float(first.interp(second, 0.5).rpy(unit="deg")[2])), 6)
    if kind is not SE3:
        apart[kind.__name__] = round(degrees(first.angdist(second)), 6)
print("half-way:", half_way, "apart:", apart)
assert half_way == {"SO3": 180, "SE3": 180, "UnitQuaternion": 0}
assert apart == {"SO3": 20, "UnitQuaternion": 10}
assert round(abs(first.interp(second, 0.5, shortest=True).rpy(unit="deg")[2]), 6) == 180
assert round(degrees(first.angdist(second, metric=4)), 6) == 20
PYTHON
