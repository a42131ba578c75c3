#!/usr/bin/env bash
# A robot (URDF), whose centre of mass is 0.2 m before and 0.1 m above its base link, with principal axes that are turned by a quarter, is put at (1, 2, 3) in PyBullet.
# A camera is on it, at (0.5, 0, 0) of the base link. Poses for a dataset are asked for. Guess: the base is at (1, 2, 3), not turned; the camera at (1.5, 2, 3).
# Seen with pybullet 3.2.7 on 2026-11-29, without a word:
# - `loadURDF(basePosition=…)` puts the base LINK there. `getBasePositionAndOrientation` gives the centre of mass, (1.2, 2, 3.1), turned by 90 degrees to the left
# - `resetBasePositionAndOrientation` with (1, 2, 3) puts the centre of mass there, and the robot lies elsewhere, turned by -90 degrees: its camera at (1, 1.7, 2.9)
# - `getLinkState` begins with the centre of mass of a link as well, here (1.55, 2, 3) for the camera; its frame in the URDF is at [4] and [5]. The base, number -1, has
#   no such entry: `getDynamicsInfo` has the way from its frame to its centre of mass, at [3] and [4]
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3.11 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check pybullet==3.2.7 numpy==2.4.6
cd "$folder"
cat >robot.urdf <<'XML'
<robot name="robot">
  <link name="base"><inertial><origin xyz="0.2 0 0.1" rpy="0 0 1.5707963267948966"/><mass value="1"/>
    <inertia ixx="1" iyy="2" izz="3" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="camera"><inertial><origin xyz="0.05 0 0"/><mass value="0.1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="pan" type="revolute"><parent link="base"/><child link="camera"/><origin xyz="0.5 0 0"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
</robot>
XML
venv/bin/python - <<'PYTHON'
import numpy as np
import pybullet

pybullet.connect(pybullet.DIRECT)
robot = pybullet.loadURDF("robot.urdf", basePosition=[1, 2, 3])
QUARTER = [0, 0, np.sqrt(0.5), np.sqrt(0.5)]


def seen(when, base, camera_mass, camera):
    """Print and check where the base and the camera are."""
    position, orientation = pybullet.getBasePositionAndOrientation(robot)
    link = pybullet.getLinkState(robot, 0, computeForwardKinematics=True)
    print(f"{when}: base {np.round(position, 3)}, {np.round(orientation, 3)}; camera {np.round(link[0], 3)}, its frame {np.round(link[4], 3)}")
    assert np.allclose(position, base[0], atol=1e-6) and np.allclose(orientation, base[1], atol=1e-6)
    assert np.allclose(link[0], camera_mass, atol=1e-6) and np.allclose(link[4], camera, atol=1e-6)


seen("loaded at (1, 2, 3)", ((1.2, 2, 3.1), QUARTER), (1.55, 2, 3), (1.5, 2, 3))
pybullet.resetBasePositionAndOrientation(robot, [1, 2, 3], [0, 0, 0, 1])
seen("reset to (1, 2, 3)", ((1, 2, 3), [0, 0, 0, 1]), (1, 1.65, 2.9), (1, 1.7, 2.9))
inertial = pybullet.getDynamicsInfo(robot, -1)[3:5]
print("from the base link to its centre of mass:", inertial)
assert np.allclose(inertial[0], (0.2, 0, 0.1)) and np.allclose(inertial[1], QUARTER)
PYTHON
