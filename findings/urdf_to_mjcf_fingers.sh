#!/usr/bin/env bash
# A mobile gripper goes from URDF into MuJoCo, and its poses are computed for labels: a base of 1 kg with a box as its shape, and two fingers of which the second one mimics the
# first, half as far (`multiplier="0.5"`). The first finger is opened by 0.03 m. Guess: the second one is at 0.015 m; the base has 1 kg.
# Seen with urdf-to-mjcf 0.1.1, urdf2any 0.3.0, fieldpilot-urdf 1.31.0 and mujoco 4.0.0 on 2026-11-30, without a word of these:
# - urdf-to-mjcf: the constraint is the wrong way round, the first finger is half of the second: which is drawn towards 0.06 m, over its limit. With a multiplier of -1, as
#   most grippers have it, both ways are the same. The base has 12 kg: its own mass is taken away as it gets a free joint, and MuJoCo takes both shapes, visual and collision, for water
# - urdf2any: in MJCF the second finger is free, with a motor of its own (in USD it says that mimic is not supported)
# - fieldpilot-urdf: `forward_kinematics` has the second finger at 0
# yourdfpy 0.0.60 has 0.015 m.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check urdf-to-mjcf==0.1.1 urdf2any==0.3.0 fieldpilot-urdf==1.31.0 mujoco==4.0.0 yourdfpy==0.0.60 numpy==2.4.6 2>/dev/null
cat > gripper.py <<'PYTHON'
import subprocess
from pathlib import Path

import fieldpilot_urdf
import mujoco
import numpy as np
import yourdfpy

OPEN_M = 0.03
SHAPE = '<geometry><box size="0.1 0.2 0.3"/></geometry>'


def link(name, mass, more=""):
    inertia = "".join(f' {axes}="{0.01 * mass if axes[1] == axes[2] else 0}"' for axes in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz"))
    return f'<link name="{name}"><inertial><mass value="{mass}"/><inertia{inertia}/></inertial>{more}</link>'


def finger(name, side, upper, more=""):
    limit = f'<limit lower="0" upper="{upper}" effort="5" velocity="1"/>'
    place = f'<parent link="base"/><child link="{name}_finger"/><axis xyz="0 {side} 0"/>{limit}'
    return link(f"{name}_finger", 0.1) + f'<joint name="{name}" type="prismatic">{place}{more}</joint>'


base = link("base", 1.0, f"<visual>{SHAPE}</visual><collision>{SHAPE}</collision>")
mimic = '<mimic joint="first" multiplier="0.5"/>'
Path("gripper.urdf").write_text(f'<robot name="gripper">{base}{finger("first", 1, 0.04)}{finger("second", -1, 0.02, mimic)}</robot>')

robot = yourdfpy.URDF.load("gripper.urdf", load_meshes=False)
robot.update_cfg({"first": OPEN_M})
true_m = -robot.get_transform("second_finger", "base")[1, 3]
places = fieldpilot_urdf.forward_kinematics(fieldpilot_urdf.from_file("gripper.urdf"), {"first": OPEN_M})
print(f"second finger: yourdfpy {true_m:.3f} m, fieldpilot-urdf {abs(places['second_finger'][1, 3]):.3f} m")
assert np.isclose(true_m, 0.015) and places["second_finger"][1, 3] == 0 and np.isclose(places["first_finger"][1, 3], OPEN_M)


def converted(tool, *options):
    """Return the model, and what the tool said about mimic joints and inertia."""
    Path(tool).mkdir()
    done = subprocess.run([f"venv/bin/{tool}", "gripper.urdf", "-o", f"{tool}/gripper.xml", *options], check=True, capture_output=True, text=True)
    said = [line for line in (done.stdout + done.stderr).splitlines() if any(word in line.lower() for word in ("mimic", "inerti", "mass"))]
    return mujoco.MjModel.from_xml_path(f"{tool}/gripper.xml"), said


model, said = converted("urdf2any")
print("urdf2any: constraints", model.neq, "motors", [model.actuator(number).name for number in range(model.nu)], "said", said)
assert model.neq == 0 and model.nu == 2 and said == [] and model.body("base").mass == 1

model, said = converted("urdf-to-mjcf")
dependent, leader = (model.joint(number).name for number in (model.eq_obj1id[0], model.eq_obj2id[0]))
factor = model.eq_data[0, 1]
print(f"urdf-to-mjcf: {dependent} = {factor} * {leader}, base {model.body('base').mass[0]:.1f} kg, said {said}")
assert (dependent, leader, factor, said) == ("first", "second", 0.5, [])
assert np.isclose(model.body("base").mass[0], 12)
# held at 0.03 m, as by a motor, the first finger draws the second one after it
data = mujoco.MjData(model)
model.opt.gravity[:] = 0
for _ in range(3000):
    data.qpos[model.joint("first").qposadr[0]] = OPEN_M
    data.qvel[model.joint("first").dofadr[0]] = 0
    mujoco.mj_step(model, data)
second_m = data.qpos[model.joint("second").qposadr[0]]
print(f"held at {OPEN_M} m, the second finger is at {second_m:.3f} m")
assert second_m > 0.019
PYTHON
venv/bin/python gripper.py > said.txt 2>&1 || { cat said.txt; exit 1; }
cat said.txt
