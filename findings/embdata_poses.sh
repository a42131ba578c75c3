#!/usr/bin/env bash
# A gripper is yawed by 90 degrees, a `Pose6D` (roll, pitch, yaw) of embdata, and becomes a rotation matrix and a quaternion; and a pose is made of a quaternion. An arm moves at 1 m/s, recorded at 50 Hz, and
# its `Trajectory` is resampled to 30 and to 20 Hz, and to actions: `relative_to(-1)`, differences of steps, and `relative_to(-2)`, of steps two apart. Guess: one rotation, about z; 1 m/s; 0.02 and 0.04 m.
# Seen with embdata 0.0.13 beside scipy 1.13.0 on 2026-11-30, without a word:
# - the matrix is a turn about x, the quaternion one about z: `rotation_matrix` takes roll for a turn about z, and yaw for one about x; its help has a matrix about z for this pose
# - `from_position_orientation` reads w, x, y, z, as it says, as x, y, z, w: a roll of 57 degrees is one of -57 and a yaw of 180
# - to 30 Hz: all 500 steps of the 50 Hz stay, said to be of 30 Hz, with 301 times: 0.6 m/s. To 20 Hz: 0.8 m/s. Every n-th step is taken, n rounded down; to 25 or 10 Hz all is right
# - `relative_to(-2)` has differences of differences: 0 m for an arm at 1 m/s
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3.11 -m venv venv
# Which its own list lacks, or which is too new for the numpy on it: pyarrow, pandas, scipy, scikit-learn, xtyping and ruamel.yaml. PyTorch is replaced by an empty module.
venv/bin/pip install --quiet --disable-pip-version-check embdata==0.0.13 xtyping==0.11.1 ruamel.yaml==0.19.1 pyarrow==17.0.0 pandas==2.2.3 scipy==1.13.0 scikit-learn==1.5.2 2>/dev/null
cat > poses.py <<'PYTHON'
import importlib.machinery
import sys
import types

import numpy as np
from scipy.spatial.transform import Rotation

torch = types.ModuleType("torch")
torch.__spec__, torch.__version__, torch.Tensor = importlib.machinery.ModuleSpec("torch", None), "2.3.1", type("Tensor", (), {})
sys.modules["torch"] = torch
from embdata.coordinate import Pose6D
from embdata.trajectory import Trajectory

yawed = Pose6D(x=0, y=0, z=0, roll=0, pitch=0, yaw=np.pi / 2)
by_matrix = Rotation.from_matrix(yawed.rotation_matrix()).as_rotvec(degrees=True)
by_quaternion = Rotation.from_quat(yawed.quaternion()).as_rotvec(degrees=True)
print("yaw of 90 degrees: by the matrix a turn of", by_matrix.round(1), "by the quaternion of", by_quaternion.round(1))
assert np.allclose(by_matrix, [90, 0, 0]) and np.allclose(by_quaternion, [0, 0, 90])
matrix = np.array(Pose6D.to.__doc__.split("array([[")[1].split("])")[0].replace("[", "").replace("]", "").split(","), float).reshape(3, 3)
print("by its help of", Rotation.from_matrix(matrix).as_rotvec(degrees=True).round(1))
assert np.allclose(Rotation.from_matrix(matrix).as_rotvec(degrees=True), [0, 0, 90])

rolled = Pose6D.from_position_orientation([0, 0, 0], [np.cos(0.5), np.sin(0.5), 0, 0])
angles_deg = np.degrees([rolled.roll, rolled.pitch, rolled.yaw])
print("roll of 57.3 degrees, by w, x, y, z:", angles_deg.round(1))
assert np.allclose(angles_deg, [-57.2958, 0, 180], atol=1e-3)

RATE_HZ = 50
way_m = np.stack([np.arange(500) / RATE_HZ, np.zeros(500)], axis=1)
for rate_hz, speed_m_s in ((30, 0.6), (20, 0.8), (25, 1.0), (10, 1.0)):
    resampled = Trajectory(way_m, freq_hz=RATE_HZ, keys=["x", "y"]).resample(rate_hz)
    speed = float(np.diff(resampled.array[:, 0]).mean() * resampled.freq_hz)
    print(f"to {rate_hz} Hz: {len(resampled.array)} steps, {len(resampled.timestamps)} times, {resampled.freq_hz} Hz, {speed:.2f} m/s")
    assert np.isclose(speed, speed_m_s)
for steps, action_m in ((-1, 0.02), (-2, 0.0)):
    action = Trajectory(way_m, freq_hz=RATE_HZ, keys=["x", "y"]).relative_to(steps).array[:, 0]
    print(f"relative_to({steps}): {action.mean():.3f} m")
    assert np.allclose(action, action_m)
PYTHON
venv/bin/python poses.py > said.txt 2>&1 || { tail -8 said.txt; exit 1; }
if grep -i warn said.txt; then exit 1; fi
grep -v DEBUG said.txt
