#!/usr/bin/env bash
# A suit of IMUs has one at the pelvis and one at the chest; three links between share the turn, a quarter each: `imumocap.solvers.interpolate`, which "interpolates the joint of each link between the first
# and last", by `Matrix.slerp`. Guess: equal steps about one axis, the shorter way around, as with scipy's Slerp, and to the right as to the left.
# Seen with imumocap 1.4.0 beside scipy 1.17.1 on 2026-11-30, without a word: a turn of 90 degrees is one of steps of 25, 20, 20, 25 degrees; 150 are 57, 18, 18, 57; of 170 the first quarter has 77 (the
# weights are sines of the whole angle; of quaternions it is half the angle). To the right it is so up to 120 degrees; from there the links are far off: 150 to the right has links at 154, 105 and 56
# degrees to the LEFT between 0 and 150 to the right. Only ends, and the middle up to there, are right. Whoever fills pauses of a pose stream with it gets jerks.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3.12 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check imumocap==1.4.0 matplotlib==3.11.2 pillow==13.0.0 scipy==1.17.1 numpy==2.4.6 2>/dev/null
cat > spine.py <<'PYTHON'
import numpy as np
from imumocap import Link, Matrix
from imumocap.solvers import interpolate
from scipy.spatial.transform import Rotation, Slerp


def headings(turn_deg):
    """Return the heading of each of five links whose first and last are set, by imumocap and by scipy, in degrees to the left."""
    links = [Link(f"link {number}", Matrix(z=0.1)) for number in range(5)]
    for lower, upper in zip(links, links[1:]):
        lower.connect(upper)
    links[-1].set_joint_world(Matrix(rot_z=turn_deg))
    interpolate(links)
    keys = Rotation.from_euler("z", [[0], [turn_deg]], degrees=True)
    right = Slerp([0, 1], keys)(np.linspace(0, 1, 5))
    both = Rotation.from_matrix([link.get_joint_world().rotation for link in links]), right
    return [turns.as_euler("zyx", degrees=True)[:, 0].round(1) for turns in both]


seen = {}
for turn_deg in (30, 60, 90, 150, 170, -90, -115, -125, -150, -170):
    got, right = headings(turn_deg)
    seen[turn_deg] = got
    print(f"{turn_deg} degrees: {got}, by scipy {right}")
    assert np.allclose(right, np.linspace(0, turn_deg, 5), atol=0.1) and np.allclose(got[[0, 4]], right[[0, 4]], atol=0.1)
    assert np.isclose(got[2], right[2], atol=0.1) == (turn_deg > -120)
assert np.allclose(np.diff(seen[90]), [25.5, 19.5, 19.5, 25.5], atol=0.1)
assert np.allclose(np.diff(seen[150]), [57.1, 17.9, 17.9, 57.1], atol=0.1)
assert np.allclose(np.diff(seen[170]), [76.6, 8.4, 8.4, 76.6], atol=0.1)
assert np.allclose(seen[-150], [0, 153.9, 105, 56.1, -150], atol=0.1)
PYTHON
venv/bin/python -W error spine.py
