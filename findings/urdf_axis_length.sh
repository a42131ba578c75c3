#!/usr/bin/env bash
# A camera rides on a rail and a hinge. The axes in its URDF are not of length 1: (2, 0, 0) for the rail and (0, 1, 1) for the hinge, as
# exporters and people write them. Where is the camera, for 0.3 m and 0.7 rad?
# Guess: every reader normalises, as the specification wants unit vectors, or refuses. Seen on 2026-11-29:
#   pin 4.1.0, urchin 0.0.30, pytransform3d 3.17.0   normalise both
#   yourdfpy 0.0.60, kinpy 0.6.1                     normalise the hinge alone: the rail moves by 0.6 m
#   ikpy 4.2.1                                       neither: the rail moves by 0.6 m, and the hinge's "rotation" is none, as it stretches:
#                                                    the camera's axes are 1.2 long, and so is the lever before it
# Nothing is said.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check pin==4.1.0 urchin==0.0.30 pytransform3d==3.17.0 yourdfpy==0.0.60 \
  kinpy==0.6.1 ikpy==4.2.1
cd "$folder"
cat >rail.urdf <<'XML'
<robot name="rail">
  <link name="base"/><link name="slide"/><link name="arm"/><link name="camera"/>
  <joint name="rail" type="prismatic"><parent link="base"/><child link="slide"/><origin xyz="0 0 1"/><axis xyz="2 0 0"/>
    <limit lower="-5" upper="5" effort="1" velocity="1"/></joint>
  <joint name="hinge" type="revolute"><parent link="slide"/><child link="arm"/><axis xyz="0 1 1"/><origin xyz="0 0 0"/>
    <limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
  <joint name="mount" type="fixed"><parent link="arm"/><child link="camera"/><origin xyz="1 0 0"/></joint>
</robot>
XML
venv/bin/python -W ignore - <<'PYTHON'
from pathlib import Path

import ikpy.chain
import kinpy
import numpy as np
import pinocchio
import urchin
import yourdfpy
from pytransform3d.urdf import UrdfTransformManager

URDF = Path("rail.urdf").read_text()
POSITIONS = {"rail": 0.3, "hinge": 0.7}

seen = {}
model = pinocchio.buildModelFromXML(URDF)
data = model.createData()
pinocchio.framesForwardKinematics(model, data, np.array([0.3, 0.7]))
seen["pin"] = data.oMf[model.getFrameId("camera")].homogeneous
seen["urchin"] = urchin.URDF.load("rail.urdf").link_fk(POSITIONS, link="camera")
manager = UrdfTransformManager()
manager.load_urdf(URDF)
for name, position in POSITIONS.items():
    manager.set_joint(name, position)
seen["pytransform3d"] = manager.get_transform("camera", "base")
robot = yourdfpy.URDF.load("rail.urdf")
robot.update_cfg(POSITIONS)
seen["yourdfpy"] = robot.get_transform("camera", "base")
seen["kinpy"] = kinpy.build_chain_from_urdf(URDF).forward_kinematics(POSITIONS)["camera"].matrix()
seen["ikpy"] = ikpy.chain.Chain.from_urdf_file("rail.urdf", base_elements=["base"]).forward_kinematics([0, 0.3, 0.7, 0])

right = seen["pin"]
assert np.allclose(right[:3, 3], [0.3 + np.cos(0.7), np.sin(0.7) / np.sqrt(2), 1 - np.sin(0.7) / np.sqrt(2)])
for name, base_SE3_camera in seen.items():
    lengths = np.linalg.norm(base_SE3_camera[:3, :3], axis=0)
    print(f"{name}: camera at {np.round(base_SE3_camera[:3, 3], 3)}, axes {np.round(lengths, 3)} long")
    assert np.allclose(base_SE3_camera[0, 3] - right[0, 3], 0.3 if name in ("yourdfpy", "kinpy") else 0) or name == "ikpy"
    assert np.allclose(lengths, 1) == (name != "ikpy")
PYTHON
