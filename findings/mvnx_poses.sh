#!/usr/bin/env bash
# A take of an Xsens suit (MVNX), as for teleoperation, has frames of three kinds before those of the motion: the null pose ("identity"), and the T-pose
# that was calibrated, by Xsens' axes ("tpose") and by those of biomechanics ("tpose-isb"). Here the pelvis is turned by 0, 90 and 120 degrees in them,
# and by 60 degrees in the motion. What does mvnx-parser have as `identity`, `tpose`, `tpose_isb`? Guess: these three. Seen with mvnx-parser 0.0.5 on
# 2026-11-29: three times the null pose. What is set to zero with its T-pose stays as it is, off by what the suit was calibrated for. And a comment of it
# calls orientations x, y, z, w; they come in the file's order, which is w, x, y, z. The time of frames (time, ms, tc) is not kept.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check mvnx-parser==0.0.5
cd "$folder"
venv/bin/python - <<'PYTHON'
from math import acos, degrees
from pathlib import Path

from mvnx_parser import Mvnx_p

ORIENTATIONS = {"identity": "1 0 0 0", "tpose": "0.7071068 0 0 0.7071068", "tpose-isb": "0.5 0.5 0.5 0.5", "normal": "0.8660254 0 0 0.5"}
frames = "".join(
    f'<frame time="17" index="0" ms="1790000000017" type="{kind}"><orientation>{wxyz}</orientation><position>0 0 1</position></frame>'
    for kind, wxyz in ORIENTATIONS.items()
)
Path("take.mvnx").write_text(
    '<?xml version="1.0" encoding="UTF-8"?><mvnx xmlns="http://www.xsens.com/mvn/mvnx" version="4"><subject frameRate="60" segmentCount="1">'
    f'<segments><segment label="Pelvis" id="1"/></segments><frames segmentCount="1">{frames}</frames></subject></mvnx>'
)
take = Mvnx_p("take.mvnx")
turned_deg = {}
for name, (quaternion,) in {
    "identity": take.identity["orientation"],
    "tpose": take.tpose["orientation"],
    "tpose_isb": take.tpose_isb["orientation"],
    "motion": take.orientation[0],
}.items():
    turned_deg[name] = round(2 * degrees(acos(float(quaternion[0]))))
print("turned by, in degrees, with w first:", turned_deg)
assert turned_deg == {"identity": 0, "tpose": 0, "tpose_isb": 0, "motion": 60}
assert set(take.frames[0]) == {"orientation", "position"}
PYTHON
