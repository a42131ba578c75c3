#!/usr/bin/env bash
# A camera is mounted by a fixed joint of a URDF 1.2, with `quat_xyzw` in place of `rpy`, as urdfdom 6 reads it. Who turns the camera?
# Guess: readers of URDF refuse a version or an attribute that they do not know. Seen on 2026-11-28:
#   pin 4.1.0 with urdfdom 6.0.0   turned in versions 1.1 and 1.2; in 1.0, or without a version, not turned, without a word
#   yourdfpy 0.0.60, urchin 0.0.30, pytransform3d 3.17.0   never turned, without a word: an optical frame looks ahead like its mount
# With both attributes urdfdom refuses the robot.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check pin==4.1.0 cmeel-urdfdom==6.0.0 yourdfpy==0.0.60 urchin==0.0.30 \
  pytransform3d==3.17.0 lxml==6.0.2
cd "$folder"
venv/bin/python - 2>stderr <<'PYTHON'
from pathlib import Path

import numpy as np
import pinocchio
from pytransform3d.urdf import UrdfTransformManager
from urchin import URDF as Urchin
from yourdfpy import URDF as Yourdfpy

TURNED = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]
ROBOT = """<robot name="car"{}><link name="base"/><link name="camera"/><joint name="mount" type="fixed">
<parent link="base"/><child link="camera"/><origin xyz="1 2 3" {}/></joint></robot>"""
QUATERNION = 'quat_xyzw="0.5 -0.5 0.5 -0.5"'


def by_pin(text):
    model = pinocchio.buildModelFromXML(text)
    return model.frames[model.getFrameId("camera")].placement.rotation


def by_yourdfpy(text):
    return Yourdfpy.load(Path("car.urdf")).get_transform("camera", "base")[:3, :3]


def by_urchin(text):
    robot = Urchin.load("car.urdf", lazy_load_meshes=True)
    return robot.link_fk(links=["camera"])[robot.link_map["camera"]][:3, :3]


def by_pytransform3d(text):
    manager = UrdfTransformManager()
    manager.load_urdf(text)
    return manager.get_transform("camera", "base")[:3, :3]


for version in ("", ' version="1.0"', ' version="1.1"', ' version="1.2"'):
    text = ROBOT.format(version, QUATERNION)
    Path("car.urdf").write_text(text)
    for read in (by_pin, by_yourdfpy, by_urchin, by_pytransform3d):
        rotation = read(text)
        turned = np.allclose(rotation, TURNED)
        print(f"{read.__name__}{version or ' without version'}: {'turned' if turned else 'not turned'}")
        assert turned or np.allclose(rotation, np.eye(3))
        assert turned == (read is by_pin and version in {' version="1.1"', ' version="1.2"'})
try:
    by_pin(ROBOT.format(' version="1.2"', QUATERNION + ' rpy="0 0 0"'))
except ValueError as error:
    print(f"both: {error}")
else:
    raise SystemExit("both attributes are no longer refused")
PYTHON
grep -q "Both rpy and quat_xyzw" stderr
