#!/usr/bin/env bash
# A gripper points straight down, as it does over a table, turned by 0 to 359 degrees about the vertical: its rotation is written as three angles, or as axis times angle, and
# read back, with DeepMind's dm-robotics-transformations (`rmat_to_euler` and `euler_to_rmat`, `rmat_to_axisangle` and `axisangle_to_rmat`). Guess: the same rotation, as
# at poles only the sharing between the outer two angles is open. Seen with dm-robotics-transformations 0.10.0 on 2026-11-30:
# - ZYZ, with the tool's z axis down: all of the 360 come back wrong, nearly all by 180 degrees, without a word
# - ZYX, with its x axis up (-90 degrees): all by 180 degrees, after "Angle at North Pole"; with it down (90) all are right, after "Angle at South Pole"
# - of half turns about other axes, axis times angle is up to 70 degrees off, without a word, half of them more than 5: the axis is what rounding leaves of 0 / 0. By
#   way of quaternions, and a ten-thousandth of a degree beside, all are right. SciPy is right in all cases
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check scipy==1.17.1 numpy==2.4.6 absl-py==2.5.0 2>/dev/null
venv/bin/pip install --quiet --disable-pip-version-check --no-deps dm-robotics-transformations==0.10.0 2>/dev/null
cat > poles.py <<'PYTHON'
import numpy as np
from dm_robotics.transformations import transformations as dm
from scipy.spatial.transform import Rotation


def off_deg(right, back):
    return np.degrees(Rotation.from_matrix(right.T @ back).magnitude())


TOOLS = {  # where the axes of the tool point
    "ZYZ, z down": ("ZYZ", np.diag([1.0, -1, -1])),
    "ZYX, x up": ("ZYX", np.array([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]])),
    "ZYX, x down": ("ZYX", np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])),
}
off = {}
for name, (order, tool) in TOOLS.items():
    turns = [Rotation.from_euler("z", yaw, degrees=True).as_matrix() @ tool for yaw in range(360)]
    off[name] = [off_deg(turn, dm.euler_to_rmat(dm.rmat_to_euler(turn, ordering=order), ordering=order)) for turn in turns]
    by_scipy = Rotation.from_euler(order, Rotation.from_matrix(turns).as_euler(order, suppress_warnings=True)).as_matrix()
    assert max(map(off_deg, turns, by_scipy)) < 1e-3
    print(f"{name}: from {min(off[name]):.3f} to {max(off[name]):.3f} degrees off")

random = np.random.default_rng(0)
for degrees in (179.9999, 180):
    axes = random.normal(size=(200, 3))
    turns = Rotation.from_rotvec(np.radians(degrees) * axes / np.linalg.norm(axes, axis=1, keepdims=True)).as_matrix()
    off[degrees] = [off_deg(turn, dm.axisangle_to_rmat(dm.rmat_to_axisangle(turn))) for turn in turns]
    quaternions = [off_deg(turn, dm.axisangle_to_rmat(dm.quat_to_axisangle(dm.mat_to_quat(turn)))) for turn in turns]
    print(f"turns by {degrees} degrees: half of them more than {np.median(off[degrees]):.1f} degrees off, {max(off[degrees]):.1f} at most; by quaternions {max(quaternions):.4f}")
    assert max(quaternions) < 1e-3
assert np.median(off["ZYZ, z down"]) > 179 and min(off["ZYZ, z down"]) > 1 and np.allclose(off["ZYX, x up"], 180, atol=1e-3) and max(off["ZYX, x down"]) < 1e-3
assert max(off[179.9999]) < 1e-3 and np.median(off[180]) > 5 and max(off[180]) > 40
PYTHON
venv/bin/python poles.py > poles.txt 2> said.txt || { tail -5 said.txt; exit 1; }
cat poles.txt
grep -o 'Angle at .*' said.txt | sort | uniq -c
if grep -i 'warn' said.txt | grep -vq 'Angle at\|where'; then exit 1; fi
