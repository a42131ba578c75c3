#!/usr/bin/env bash
# A model of MuJoCo becomes a URDF, so that joint angles of simulated episodes can be turned into poses of the hand elsewhere: a turntable that turns without end, an upper
# arm whose drawing has its joint at 1.5 rad (`ref`), a wrist of three joints about points of its own. Shapes are capsules, cylinders and boxes.
# Guess: with the same angles the hand is at the same place; or the converter says what it cannot do. Seen with mjcf_urdf_simple_converter 0.7.3, cyberwave-robot-format
# 0.1.8 and mujoco 4.0.0 on 2026-11-30, without a word:
# - both: the zero of an arm with `ref` is not MuJoCo's, so that the hand is 43 cm off (1.5 rad)
# - the simple converter: the third joint of the wrist is 10 cm off (its place is counted from the sum of the others',
#   not from the last); the turntable may turn from 0 to 0 rad; no link has any shape, as only meshes are kept
# - cyberwave: the `euler` angles of a body (0.5 rad) are gone; a joint's own point shifts the whole link behind it; of the three joints of the wrist each has that one link
#   as its child, which is no tree; the arm's capsule is gone, the turntable's cylinder is kept
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check mjcf_urdf_simple_converter==0.7.3 cyberwave-robot-format==0.1.8 mujoco==4.0.0 yourdfpy==0.0.60 \
  scipy==1.17.1 numpy==2.4.6 2>/dev/null
cat > arms.py <<'PYTHON'
import xml.etree.ElementTree as ET

import mujoco
import numpy as np
import yourdfpy
from cyberwave_robot_format import MJCFParser, URDFExporter
from mjcf_urdf_simple_converter.mjcf_urdf_simple_converter import convert

CAPSULE = '<geom type="capsule" size="0.03" fromto="0 0 0 0 0 0.3" mass="1"/>'
WRIST = "".join(
    f'<joint name="{name}" axis="{axis}" range="-1 1" pos="{place}"/>'
    for name, axis, place in (("roll", "1 0 0", "0 0 0.1"), ("pitch", "0 1 0", "0 0 0.1"), ("yaw", "0 0 1", "0.05 0 0.1"))
)
ARMS = {  # what is in the body "arm", and its attributes
    "plain": ("", '<joint name="lift" axis="0 1 0" range="-2 2"/>'),
    "ref": ("", '<joint name="lift" axis="0 1 0" range="-2 2" ref="1.5"/>'),
    "euler": ('euler="0 0.5 0"', '<joint name="lift" axis="0 1 0" range="-2 2"/>'),
    "point": ("", '<joint name="lift" axis="0 1 0" range="-2 2" pos="0 0 0.1"/>'),
    "wrist": ("", WRIST),
}
ANGLES = {"turn": 0.7, "lift": 0.4, "roll": 0.2, "pitch": -0.3, "yaw": 0.4}


def place_in_mujoco(path):
    model = mujoco.MjModel.from_xml_path(path)
    data = mujoco.MjData(model)
    for number in range(model.njnt):
        data.qpos[number] = ANGLES[model.joint(number).name]
    mujoco.mj_forward(model, data)
    return data.body("hand").xpos


def place_in_urdf(path):
    robot = yourdfpy.URDF.load(path, load_meshes=False)
    robot.update_cfg([ANGLES[name] for name in robot.actuated_joint_names])
    return robot.get_transform("hand", robot.base_link)[:3, 3]


off_m = {}
for name, (attributes, joints) in ARMS.items():
    hand = '<body name="hand" pos="0.1 0 0.3"><geom type="box" size="0.02 0.02 0.02" mass="0.1"/></body>'
    arm = f'<body name="arm" pos="0 0 0.2" {attributes}>{joints}{CAPSULE}{hand}</body>'
    table = f'<body name="table" pos="0 0 0.1"><joint name="turn" axis="0 0 1"/><geom type="cylinder" size="0.1 0.02" mass="1"/>{arm}</body>'
    text = f'<mujoco model="arm"><compiler angle="radian"/><worldbody>{table}</worldbody></mujoco>'
    with open(f"{name}.xml", "w") as file:
        file.write(text)
    convert(f"{name}.xml", f"{name}.simple.urdf")
    URDFExporter().export(MJCFParser().parse(f"{name}.xml"), f"{name}.cyberwave.urdf")
    right = place_in_mujoco(f"{name}.xml")
    for tool in ("simple", "cyberwave"):
        if (tool, name) != ("cyberwave", "wrist"):
            off_m[tool, name] = round(float(np.linalg.norm(place_in_urdf(f"{name}.{tool}.urdf") - right)), 3)
print("metres off:", off_m)
expected = {("simple", "plain"): 0, ("simple", "euler"): 0, ("simple", "point"): 0, ("cyberwave", "plain"): 0}
assert {key: off for key, off in off_m.items() if not off} == expected
assert np.allclose([off_m["simple", "ref"], off_m["cyberwave", "ref"]], 2 * np.sin(0.75) * np.hypot(0.1, 0.3), atol=1e-3)
assert np.isclose(off_m["cyberwave", "point"], 0.1, atol=1e-3)

shapes, parents, limits = {}, {}, {}
for tool in ("simple", "cyberwave"):
    robot = ET.parse(f"wrist.{tool}.urdf")
    shapes[tool] = [link.get("name") for link in robot.iter("link") if link.find("visual") is not None]
    parents[tool] = [joint.get("name") for joint in robot.iter("joint") if joint.find("child").get("link") == "arm"]
    turn = robot.find("joint[@name='turn']/limit")
    limits[tool] = None if turn is None else (turn.get("lower"), turn.get("upper"))
print("links with a shape:", shapes, "; joints that lead to the arm:", parents, "; limits of the turntable:", limits)
assert shapes == {"simple": [], "cyberwave": ["table", "hand"]}
assert parents["cyberwave"] == ["roll", "pitch", "yaw"] and len(parents["simple"]) == 1
assert limits["simple"] == ("0.0", "0.0")
PYTHON
venv/bin/python arms.py > arms.txt 2>&1 || { cat arms.txt; exit 1; }
cat arms.txt
if grep -iE 'warn|skip|unsupported|support' arms.txt; then exit 1; fi
