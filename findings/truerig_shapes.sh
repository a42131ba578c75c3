#!/usr/bin/env bash
# A robot arm is converted with TrueRig, which says of itself "conversion you can trust - with a fidelity report of everything it changed": a URDF with a box off the middle of its
# link and a cylinder that lies on its side becomes USD and MJCF; a model of MuJoCo with a joint about a point of its own (`pos`), whose mesh is in millimetres, becomes a URDF.
# Guess: the same shapes at the same places, the same hand for the same angle; or the report says what is not.
# Seen with truerig 0.1.1, usd-core 26.11 and mujoco 4.0.0 on 2026-11-30; each report: "verdict: PASS errors=0 warnings=0", and no word of these:
# - USD: a box of 0.1 x 0.2 x 0.3 m at (0.5, 0, 0.2) is at (0.05, 0, 0.06), as its place is scaled like the box (scale stands before translate); shapes are not turned:
#   the cylinder stands. In MJCF both are right
# - URDF: the joint turns about the origin of its link, so the hand is 10 cm off at 1 rad; a mesh is 1000 times as large (its `scale` is gone), and at the place and in the
#   orientation that MuJoCo gives to its centre of mass and principal axes, to which the vertices of the file do not belong. `effort` and `damping` are not in it
# Its own `simcheck` says FAIL of the URDF; of the USD it cannot.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check truerig==0.1.1 usd-core==26.11 mujoco==4.0.0 yourdfpy==0.0.60 trimesh==5.2.0 scipy==1.17.1 numpy==2.4.6 2>/dev/null
cat > arm.urdf <<'URDF'
<robot name="arm">
  <link name="base">
    <collision><origin xyz="0.5 0 0.2"/><geometry><box size="0.1 0.2 0.3"/></geometry></collision>
    <collision><origin xyz="0 0 0.4" rpy="0 1.5707963267948966 0"/><geometry><cylinder radius="0.05" length="0.6"/></geometry></collision>
  </link>
</robot>
URDF
cat > arm.xml <<'MJCF'
<mujoco model="arm">
  <asset><mesh name="board" file="board.obj" scale="0.001 0.001 0.001"/></asset>
  <worldbody>
    <body name="base">
      <geom type="box" size="0.05 0.05 0.05"/>
      <body name="upper" pos="0 0 0.2">
        <joint name="lift" axis="0 1 0" pos="0 0 0.1" range="-60 60" damping="2" actuatorfrcrange="-5 5"/>
        <geom type="mesh" mesh="board"/>
        <body name="hand" pos="0 0 0.3"><geom type="sphere" size="0.02"/></body>
      </body>
    </body>
  </worldbody>
</mujoco>
MJCF
cat > look.py <<'PYTHON'
import json
import subprocess
from pathlib import Path

import mujoco
import numpy as np
import trimesh
import yourdfpy
from pxr import Usd, UsdGeom

board_mm = trimesh.creation.box((400, 300, 20))
board_mm.apply_translation((200, 150, 10))
board_mm.export("board.obj")


def convert(source, target):
    """Convert, and return the words of the report."""
    said = subprocess.run(["venv/bin/truerig", "convert", "--strict", source, target, "--report", "json"], check=True, capture_output=True, text=True)
    report = json.loads(said.stdout)
    assert not [event for event in report.get("events", []) if event.get("severity") in ("warn", "error")], report
    return said.stdout


def box_of(vertices):
    return np.round([vertices.min(axis=0), vertices.max(axis=0)], 3).tolist()


said = convert("arm.urdf", "arm.usda")
stage, cache = Usd.Stage.Open("arm.usda"), UsdGeom.BBoxCache(Usd.TimeCode.Default(), ["default"])
shapes = []
for name in ("collision_0", "collision_1"):
    box = cache.ComputeWorldBound(stage.GetPrimAtPath(f"/arm/base/{name}")).ComputeAlignedRange()
    shapes.append(np.round([box.GetMidpoint(), box.GetSize()], 3).tolist())
print("USD, middle and size of box and cylinder:", shapes)
assert shapes[0] == [[0.05, 0, 0.06], [0.1, 0.2, 0.3]]
assert shapes[1] == [[0, 0, 0.4], [0.1, 0.1, 0.6]]
convert("arm.urdf", "again.xml")
model = mujoco.MjModel.from_xml_path("again.xml")
turned = np.zeros(9)
mujoco.mju_quat2Mat(turned, model.geom_quat[1])
assert np.allclose(model.geom_pos[0], [0.5, 0, 0.2]) and np.allclose(turned.reshape(3, 3)[:, 2], [1, 0, 0])

convert("arm.xml", "arm_out.urdf")
model = mujoco.MjModel.from_xml_path("arm.xml")
data = mujoco.MjData(model)
data.qpos[0] = 1.0
mujoco.mj_forward(model, data)
robot = yourdfpy.URDF.load("arm_out.urdf", load_meshes=False)
robot.update_cfg([1.0])
hand = robot.get_transform("hand", "base")[:3, 3]
off_m = np.linalg.norm(hand - data.body("hand").xpos)
print(f"URDF: hand at {np.round(hand, 3)}, in MuJoCo at {np.round(data.body('hand').xpos, 3)}: {off_m:.3f} m off")
assert 0.09 < off_m < 0.11
(upper,) = [link for link in robot.robot.links if link.name == "upper"]
(shape,) = upper.collisions
assert Path(shape.geometry.mesh.filename).name == "board.obj" and shape.geometry.mesh.scale is None
written = trimesh.transform_points(board_mm.vertices, shape.origin)
number = model.geom_dataid[1]
of_mesh = slice(model.mesh_vertadr[number], model.mesh_vertadr[number] + model.mesh_vertnum[number])
upright = np.zeros(9)
mujoco.mju_quat2Mat(upright, model.geom_quat[1])
true = model.mesh_vert[of_mesh] @ upright.reshape(3, 3).T + model.geom_pos[1]
print("mesh in its link: in MuJoCo", box_of(true), "in the URDF", box_of(written))
assert box_of(true) == [[0, 0, 0], [0.4, 0.3, 0.02]]
assert (np.ptp(written, axis=0).round() == [20, 300, 400]).all()
lift = robot.joint_map["lift"]
assert lift.limit.effort is None and lift.dynamics is None
check = subprocess.run(["venv/bin/truerig", "simcheck", "arm.xml", "arm_out.urdf"], capture_output=True, text=True)
print(check.stdout.splitlines()[0] if check.stdout else check.stderr.splitlines()[-1])
PYTHON
venv/bin/python look.py > said.txt 2>&1 || { cat said.txt; exit 1; }
cat said.txt
