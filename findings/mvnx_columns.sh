#!/usr/bin/env bash
# A take of an Xsens suit (MVNX), for teleoperation, is exported with the kinds of data that are needed, as one ticks them in MVN: orientation, position, joint angles, centre of mass; and another one with
# all of them. Each frame names its data: <jointAngle>. What does mvnx have as joint angles, and as velocities? Guess: the joint angles; no velocities.
# Seen with mvnx 0.2 on 2026-11-30, without a word: of the first take joint angles are empty, and `velocity` is the joint angles, `acceleration` the centre of mass: data are taken by their place in
# the frame, as if all kinds were always there, and not by name. Of the second take all is right.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check --no-deps mvnx==0.2 numpy==2.4.6 2>/dev/null
cat > take.py <<'PYTHON'
from pathlib import Path

import mvnx
import numpy as np

KINDS = ("orientation", "position", "velocity", "acceleration", "angularVelocity", "angularAcceleration", "footContacts", "sensorFreeAcceleration", "sensorMagneticField", "sensorOrientation")
KINDS = (*KINDS, "jointAngle", "jointAngleXZY", "jointAngleErgo", "centerOfMass")
VALUES = {kind: f"{number} {number} {number}" for number, kind in enumerate(KINDS)}
CALIBRATION = ("identity", "tpose", "tpose-isb")
COUNT = 10


def write(path, kinds):
    """Write frames of motion that have these kinds of data, after those of calibration."""

    def frame(number, kind):
        data = "".join(f"<{name}>{VALUES[name]}</{name}>" for name in kinds)
        return f'<frame time="{17 * number}" index="{number}" tc="10:00:00:{number:02}" ms="{1790000000000 + 17 * number}" type="{kind}">{data}</frame>'

    frames = "".join(frame(0, kind) for kind in CALIBRATION) + "".join(frame(number, "normal") for number in range(COUNT))
    Path(path).write_text(
        '<?xml version="1.0" encoding="UTF-8"?><mvnx xmlns="http://www.xsens.com/mvn/mvnx" version="4"><mvn version="2023.2" build="1"/><comment/>'
        '<subject label="A" frameRate="60" segmentCount="1" recDate="2026" configuration="FullBody" userScenario="singleLevel"><comment/>'
        '<segments><segment label="Pelvis" id="1"/></segments><sensors><sensor label="Pelvis"/></sensors><joints/><ergonomicJointAngles/><footContactDefinition/>'
        f'<frames segmentCount="1">{frames}</frames></subject><securityCode code="0"/></mvnx>'
    )
    return mvnx.load(str(path))


found = {}
for name, kinds in (("all", KINDS), ("few", ("orientation", "position", "jointAngle", "centerOfMass"))):
    take = write(f"{name}.mvnx", kinds)
    found[name] = {kind: [KINDS[int(number)] for number in np.unique(getattr(take, kind))] for kind in ("orientation", "velocity", "acceleration", "jointAngle", "centerOfMass")}
    found[name]["frames"] = len(take.orientation)
    print(f"{name}: {found[name]}")
assert found["all"] == {kind: [kind] for kind in ("orientation", "velocity", "acceleration", "jointAngle", "centerOfMass")} | {"frames": COUNT}
assert found["few"] == {"orientation": ["orientation"], "velocity": ["jointAngle"], "acceleration": ["centerOfMass"], "jointAngle": [], "centerOfMass": [], "frames": COUNT}
PYTHON
venv/bin/python -W error take.py
