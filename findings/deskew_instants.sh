#!/usr/bin/env bash
# A vehicle drives at 10 m/s, a sweep of its lidar takes 0.1 s, and a wall is 20 m ahead when it begins. Two programs for lidar odometry, of which one began as the other,
# straighten the sweep; the points have their times. Where is the wall, and so of which instant is the cloud?
# Guess: of the same instant in both, the end, as KISS-ICP's newer versions have it; and times in seconds, as drivers give them, are well in both.
# Seen with kiss-icp 1.3.0 and genz-icp 0.3.2 on 2026-11-30, by the preprocessor of each (`get_preprocessor`; whole trajectories were not compared), without a word:
# - kiss-icp: 19 m, of the END of the sweep. genz-icp: 19.5 m, of its MIDDLE. So straightened clouds are half a sweep apart, 0.5 m here, and neither is of the stamp where that is
#   the time of the first point
# - genz-icp takes times for shares of the sweep, from 0 to 1. In seconds from 0 to 0.1 the wall is at 19.5 to 18.6 m, as crooked as it was, and half a sweep nearer
# - kiss-icp takes the first and last time of a cloud for begin and end of the sweep: half of a revolution (a cloud that was cut) is straightened by the motion of a whole one,
#   and the wall leans by 0.5 m, from 19 to 19.5 m. genz-icp, of shares, has 19.5 m throughout
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check kiss-icp==1.3.0 genz-icp==0.3.2 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import genz_icp.config
import genz_icp.preprocess
import kiss_icp.config
import kiss_icp.preprocess
import numpy as np

MOTION_M = 1.0  # in a sweep
times_s = np.linspace(0, 0.1, 101)
wall = np.column_stack([20 - MOTION_M * times_s / 0.1, np.linspace(-5, 5, 101), np.zeros(101)])
begin_SE3_end = np.eye(4)
begin_SE3_end[0, 3] = MOTION_M


def straightened(package, points, times_s):
    """Return how far ahead the wall is after the package's preprocessing."""
    config = package.config.load_config(None)
    config.data.deskew, config.data.max_range, config.data.min_range = True, 100.0, 0.0
    return package.preprocess.get_preprocessor(config).preprocess(points, times_s, begin_SE3_end)[:, 0]


for package, unit, instant in ((kiss_icp, "s", 1.0), (genz_icp, "share", 0.5), (genz_icp, "s", None)):
    times = times_s if unit == "s" else times_s / 0.1
    whole, half = straightened(package, wall, times), straightened(package, wall[:51], times[:51])
    print(f"{package.__name__}, {unit}: the wall is {whole.min():.2f} to {whole.max():.2f} m ahead, of half a revolution {half.min():.2f} to {half.max():.2f}")
    if instant is None:
        assert np.allclose(whole[[0, -1]], [19.5, 18.6])
    else:
        assert np.allclose(whole, 20 - instant * MOTION_M)
        assert np.isclose(np.ptp(half), MOTION_M / 2 if package is kiss_icp else 0, atol=1e-6)
PYTHON
