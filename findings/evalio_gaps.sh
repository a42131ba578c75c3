#!/usr/bin/env bash
# A car drives round a circle of 50 m at 10 m/s. The reference has ten poses a second, but none for ten seconds, as in a tunnel; the trajectory that is judged
# has its keyframes, one a second, and is perfect. What is its error? Guess: none; poses without a partner are left out, as evo leaves them out. Seen with
# evalio 0.6.1 and evo 1.38.1 on 2026-11-30, without a word:
# - evo: 0 m, of 21 pairs. evalio: up to 48 m (absolute), and up to 78 m within a second (relative), of 30 pairs: each keyframe has the reference pose that is
#   nearest in time, up to 5 s away, with no limit, and nothing is interpolated
# - where the reference has no gap, or where the trajectory has the higher rate, it is 0 m: which of both is searched depends on the rate
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check evalio==0.6.1 evo==1.38.1 numpy==2.4.6 scipy==1.17.1 pandas==3.1.1
cat > judge.py <<'PYTHON'
import numpy as np
from evalio import stats, types
from evo.core import metrics, sync, trajectory

RADIUS_M, SPEED_M_S = 50.0, 10.0


def poses(times_s):
    yaw = times_s * SPEED_M_S / RADIUS_M
    places = RADIUS_M * np.column_stack([np.sin(yaw), 1 - np.cos(yaw), 0 * yaw])
    return places, np.column_stack([np.cos(yaw / 2), 0 * yaw, 0 * yaw, np.sin(yaw / 2)])


def evalio_of(times_s):
    stamps = [types.Stamp(sec=int(each), nsec=round(each % 1 * 10) * 10**8) for each in times_s]
    made = [types.SE3(types.SO3(qx=x, qy=y, qz=z, qw=w), place) for place, (w, x, y, z) in zip(*poses(times_s), strict=True)]
    return types.Trajectory(stamps=stamps, poses=made)


def judged(reference_s, keyframes_s):
    reference, keyframes = evalio_of(reference_s), evalio_of(keyframes_s)
    absolute, relative = stats.ate(keyframes, reference).trans, stats.rte(keyframes, reference, stats.WindowSeconds(1.0)).trans
    pair = sync.associate_trajectories(*(trajectory.PoseTrajectory3D(*poses(times_s), times_s) for times_s in (reference_s, keyframes_s)))
    ape = metrics.APE(metrics.PoseRelation.translation_part)
    ape.process_data(pair)
    return len(absolute), absolute.max(), relative.max(), len(ape.error), ape.error.max()


ten_hz, one_hz = np.arange(300) / 10, np.arange(30.0)
tunnel = ten_hz[(ten_hz <= 10) | (ten_hz >= 20)]
for name, reference_s, keyframes_s, wrong in (("whole", ten_hz, one_hz, False), ("tunnel", tunnel, one_hz, True), ("tunnel, 10 Hz", tunnel, ten_hz, False)):
    pairs, absolute_m, relative_m, evo_pairs, evo_m = judged(reference_s, keyframes_s)
    print(f"{name}: evalio {absolute_m:.1f} m, {relative_m:.1f} m in a second, of {pairs}; evo {evo_m:.1f} m of {evo_pairs}")
    assert evo_m < 1e-6
    assert np.allclose([absolute_m, relative_m], [47.9, 78.3] if wrong else 0, atol=0.1)
    assert not wrong or (pairs, evo_pairs) == (30, 21)
PYTHON
venv/bin/python judge.py > judged.txt 2> said.txt
cat judged.txt
if grep -iE 'warn|gap|match' said.txt; then exit 1; fi
