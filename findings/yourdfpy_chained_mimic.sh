#!/usr/bin/env bash
# A finger joint mimics another that mimics a third, as in grippers that are driven by one motor. Where does yourdfpy put the finger?
# Guess: where the chain leads, in whatever order the joints stand in the file. Seen with yourdfpy 0.0.60 on 2026-11-28: a joint whose
# master is no actuated one takes the master for 0, so that only its own offset is left: 0.1 rad instead of -0.5 rad. The log warns;
# the transform has no sign of it. Positions may also lie beyond the limits (0.3 of 0.2 rad): those are not looked at.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check yourdfpy==0.0.60 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import io
import math

import yourdfpy

JOINT = (
    '<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{2}"/><axis xyz="0 0 1"/>'
    '<limit lower="-{3}" upper="{3}" effort="1" velocity="1"/>{4}</joint>'
)
joints = [
    JOINT.format("motor", "palm", "crank", 0.2, ""),
    JOINT.format("knuckle", "crank", "rod", 3, '<mimic joint="motor" multiplier="-1"/>'),
    JOINT.format("tip", "rod", "finger", 3, '<mimic joint="knuckle" multiplier="2" offset="0.1"/>'),
]
links = "".join(f'<link name="{name}"/>' for name in ("palm", "crank", "rod", "finger"))
for order in (joints, joints[::-1]):
    robot = yourdfpy.URDF.load(io.StringIO(f'<robot name="gripper">{links}{"".join(order)}</robot>'))
    robot.update_cfg([0.3])
    matrices = [robot.get_transform(*pair) for pair in (("crank", "palm"), ("rod", "crank"), ("finger", "rod"))]
    angles = [round(math.atan2(matrix[1, 0], matrix[0, 0]), 6) for matrix in matrices]
    print("motor, knuckle, tip:", angles, "as the chain has it:", [0.3, -0.3, -0.5])
    if angles != [0.3, -0.3, 0.1]:
        raise SystemExit("no longer so")
PYTHON
