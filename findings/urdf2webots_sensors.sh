#!/usr/bin/env bash
# A robot (URDF) becomes one of Webots: a lift that slides along z between 0.2 and 0.6 m; a tool whose inertia is given in axes turned by 30 degrees about z (`rpy` of `inertial`); a lidar of 16 rings from
# 15 degrees below to 5 above, and of -30 to 120 degrees around. Guess: as in URDF, the lift in the middle of its range, 0.4 m up, as the importer has it where 0 is not in it; the inertia turned, as by
# MuJoCo; and the lidar's rays at these angles, turned by a pose where Webots can only have symmetric ones.
# Seen with urdf2webots 2025.0.0 beside mujoco 4.0.0 on 2026-11-30, without a word:
# - the lift is 0.4 m FORWARD while its joint says 0.4 m along z: what lies along y or z is added to x, so the arm stands beside its mast in each picture that is rendered
# - the inertia is turned the other way, by -30 degrees: the product of x and y has the other sign
# - rays of 10 degrees below to 10 above, and -75 to 75 degrees around: widths alone are kept, so labels and pictures of that lidar are 5 and 45 degrees off
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check urdf2webots==2025.0.0 rospkg==1.6.1 pillow==13.0.0 mujoco==4.0.0 numpy==2.4.6 2>/dev/null
cat > convert.py <<'PYTHON'
import re
from math import degrees, radians
from pathlib import Path

import mujoco
import numpy as np
from urdf2webots.importer import convertUrdfContent

LOW_M, HIGH_M, TURN_RAD = 0.2, 0.6, radians(30)
BOX = '<geometry><box size="0.1 0.1 0.1"/></geometry>'
URDF = f"""<robot name="lifter">
  <link name="mast"><inertial><mass value="10"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial><visual>{BOX}</visual></link>
  <link name="tool"><inertial><origin xyz="0 0 0" rpy="0 0 {TURN_RAD}"/><mass value="2"/><inertia ixx="0.1" ixy="0" ixz="0" iyy="0.3" iyz="0" izz="0.35"/></inertial>
    <visual>{BOX}</visual></link>
  <joint name="lift" type="prismatic"><parent link="mast"/><child link="tool"/><origin xyz="0 0 1"/><axis xyz="0 0 1"/><limit lower="{LOW_M}" upper="{HIGH_M}" effort="100" velocity="1"/></joint>
  <gazebo reference="mast"><sensor type="ray" name="lidar"><ray><scan>
    <horizontal><samples>300</samples><min_angle>{radians(-30)}</min_angle><max_angle>{radians(120)}</max_angle></horizontal>
    <vertical><samples>16</samples><min_angle>{radians(-15)}</min_angle><max_angle>{radians(5)}</max_angle></vertical>
  </scan><range><min>0.5</min><max>100</max></range></ray></sensor></gazebo>
</robot>"""

convertUrdfContent(URDF, output="Lifter.proto")
proto = Path("Lifter.proto").read_text()


def numbers(name, text=proto):
    """Return the numbers that stand behind this field."""
    return [float(number) for number in re.search(rf"{name} \[?\s*((?:-?[\d.]+(?:e[-+]\d+)?\s+)+)", text).group(1).split()]


position_m, axis, place_m = numbers("position")[0], numbers("axis"), numbers("translation", proto[proto.index("endPoint") :])
print(f"lift: position {position_m} along {axis}, and the tool is at {place_m}; the joint's origin is 1 m up")
assert np.isclose(position_m, (LOW_M + HIGH_M) / 2) and axis == [0, 0, 1] and place_m == [position_m, 0, 1]

wide_deg, high_deg = degrees(numbers("fieldOfView")[0]), degrees(numbers("verticalFieldOfView")[0])
pose = [line.strip() for line in proto[: proto.index("Lidar {")].splitlines() if "Pose {" in line or line.strip().startswith("rotation 0")]
print(f"lidar: {wide_deg:.1f} degrees wide, {high_deg:.1f} high, poses around it: {pose}")
assert np.allclose([wide_deg, high_deg], [150, 20], atol=1e-4) and pose == []

*diagonal, xy, xz, yz = numbers("inertiaMatrix")
model = mujoco.MjModel.from_xml_string(re.sub("<gazebo.*</gazebo>", "", URDF, flags=re.DOTALL))
turn = np.zeros(9)
mujoco.mju_quat2Mat(turn, model.body_iquat[-1])
by_mujoco = turn.reshape(3, 3) @ np.diag(model.body_inertia[-1]) @ turn.reshape(3, 3).T
print("inertia:", diagonal, xy, xz, yz, "- by MuJoCo:", by_mujoco.round(4).tolist())
assert np.allclose(diagonal, np.diag(by_mujoco)) and np.isclose(xy, -by_mujoco[0, 1]) and abs(xy) > 0.08
PYTHON
venv/bin/python -W error convert.py > said.txt 2>&1 || { tail -5 said.txt; exit 1; }
if grep -i warn said.txt; then exit 1; fi
grep '^lift:\|^lidar:\|^inertia:' said.txt
