#!/usr/bin/env bash
# An estimate of 200 poses a second, for the last 2 s of a minute, is compared with a reference of 10 a second. How often does evo use
# one pose of the reference? Guess: once, as the script of the TUM benchmark does, which takes away what is matched.
# Seen with evo 1.38.1 on 2026-11-28: the trajectory with fewer poses is gone through, here the estimate, and each takes the nearest
# pose within 0.01 s: three and more share one. From match to match the reference stands still while the estimate moves on, so the
# relative error per frame of an estimate without any is its motion, 0.05 m at 10 m/s, and no word warns of it.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check evo==1.38.1 numpy==2.4.6
"$folder/venv/bin/python" - <<'PYTHON'
import numpy as np
from evo.core import metrics, sync
from evo.core.trajectory import PoseTrajectory3D

SPEED = 10.0  # m/s along x


def drive(times):
    """Return the true poses at some times."""
    times = np.asarray(times, dtype=float)
    positions = np.column_stack([SPEED * times, np.zeros_like(times), np.zeros_like(times)])
    return PoseTrajectory3D(positions, np.tile([1.0, 0.0, 0.0, 0.0], (len(times), 1)), times)


reference, estimate = drive(np.arange(600) / 10), drive(58 + np.arange(400) / 200)
matched, matching = sync.associate_trajectories(reference, estimate)
most = np.unique(matched.timestamps, return_counts=True)[1].max()
step = metrics.RPE(metrics.PoseRelation.translation_part, delta=1, delta_unit=metrics.Unit.frames, all_pairs=False)
step.process_data((matched, matching))
errors = step.error
print(f"{matching.num_poses} matches with {len(set(matched.timestamps))} poses of the reference, up to {most} with one")
print(f"relative errors: median {np.median(errors):.3f} m, largest {errors.max():.3f} m")
assert most >= 3
assert abs(np.median(errors) - 0.05) < 1e-6
PYTHON
