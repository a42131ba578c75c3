#!/usr/bin/env bash
# A network that predicts orientations is judged with quatorch, quaternions in PyTorch: the angle between prediction and truth is that of `predicted * truth.inverse()` (`to_axis_angle`),
# and poses between frames come of `slerp`. Numbers are float32, as they come from a network. Guess: the error of a perfect prediction is 0; a small one is right to a few per cent; the
# shorter way is taken between q and -q, which are one orientation.
# Seen with quatorch 0.3.0 and torch 2.13.0 on 2026-11-30, without a word:
# - the error of a perfect prediction is NaN for a fifth of random orientations, as w is a little above 1 there, and so is any mean of errors
# - 0.03 degrees are 0.04, 0.01 degrees are 0, with an axis 8726 long; -q of an orientation 11.5 degrees away is 348.5 degrees away
# - `slerp` to -q goes the long way round: half-way between 0 and 11.5 degrees is -174 degrees
# In float64 the NaN stay; angles are right. SciPy 1.17.1 has 0, the shorter way, and 0.01 degrees, of the same numbers.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check torch==2.13.0 2>/dev/null
venv/bin/pip install --quiet --disable-pip-version-check quatorch==0.3.0 scipy==1.17.1 numpy==2.4.6 2>/dev/null
cat > errors.py <<'PYTHON'
import math

import numpy as np
import torch
from quatorch import Quaternion
from scipy.spatial.transform import Rotation, Slerp


def turned(degrees):
    half = math.radians(degrees) / 2
    return Quaternion(torch.tensor([math.cos(half), 0, 0, math.sin(half)]))


def opposite(quaternion):
    return Quaternion(-torch.Tensor(quaternion))


def heading(quaternion):
    w, _, _, z = (float(value) for value in torch.Tensor(quaternion))
    return math.degrees(math.remainder(2 * math.atan2(z, w), math.tau))


def in_scipy(quaternion):
    return Rotation.from_quat(torch.Tensor(quaternion).numpy().astype(float), scalar_first=True)


shares = {}
for kind in (torch.float32, torch.float64):
    random = torch.randn(10_000, 4, generator=torch.Generator().manual_seed(0), dtype=kind)
    truth = Quaternion(random / random.norm(dim=-1, keepdim=True))
    difference = truth * truth.inverse()
    _, error = difference.to_axis_angle()
    shares[kind] = torch.isnan(error).double().mean().item()
    if kind == torch.float32:
        assert in_scipy(difference).magnitude().max() < 1e-5
print("share of NaN among the errors of perfect predictions:", shares)
assert 0.1 < shares[torch.float32] < 0.4 and shares[torch.float64] > 0.05

found = {}
for degrees in (1, 0.03, 0.01):
    axis, angle = turned(degrees).to_axis_angle()
    found[degrees] = math.degrees(angle), float(axis.norm())
    assert abs(math.degrees(in_scipy(turned(degrees)).magnitude()) / degrees - 1) < 1e-4
print("degrees: found, length of the axis", {degrees: [round(value, 4) for value in values] for degrees, values in found.items()})
assert abs(found[1][0] - 1) < 0.001 and 0.035 < found[0.03][0] < 0.045 and found[0.01][0] == 0 and found[0.01][1] > 8000

near = 11.5
_, angle = opposite(turned(near)).to_axis_angle()
halfway = [heading(turned(0).slerp(end, 0.5)) for end in (turned(near), opposite(turned(near)))]
print(f"-q of {near} degrees: {math.degrees(angle):.1f}; half-way to q and -q: {[round(value, 2) for value in halfway]}")
assert abs(math.degrees(angle) - 348.5) < 0.1
assert abs(halfway[0] - near / 2) < 0.01 and abs(halfway[1] + 180 - near / 2) < 0.01
by_scipy = Slerp([0, 1], Rotation.concatenate([in_scipy(turned(0)), in_scipy(opposite(turned(near)))]))(0.5)
assert np.isclose(np.degrees(by_scipy.magnitude()), near / 2, atol=0.01)
PYTHON
venv/bin/python errors.py > said.txt 2> warned.txt || { cat said.txt; tail -3 warned.txt; exit 1; }
if grep -i warn warned.txt; then exit 1; fi
cat said.txt
