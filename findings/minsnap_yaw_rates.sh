#!/usr/bin/env bash
# A drone flies a circle of 5 m in 8 s, and looks ahead: minsnap-trajectories makes its poses and the body rates that fly it (`compute_quadrotor_trajectory` with
# `yaw="velocity"`, as its README has it), as a simulated episode of states and actions, or in place of a gyroscope.
# Guess: rates that, added up, are the turns between the poses. Seen with minsnap-trajectories 0.3.0 on 2026-11-30, without a word: about the vertical the body
# rate lacks the yaw, -0.08 where the poses turn by 0.77 rad/s, since `yaw_rate` is 0 unless it is given, also where the yaw follows the path. Whoever flies the
# rates through the middle 6 s looks 142 degrees off at the end; with the yaw and its rate given by hand, 0.4
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check minsnap-trajectories==0.3.0 scipy==1.17.1 numpy==2.4.6 2>/dev/null
venv/bin/python - <<'PYTHON'
import minsnap_trajectories as minsnap
import numpy as np
from scipy.spatial.transform import Rotation

STEP_S = 0.01
angles = np.linspace(0, 2 * np.pi, 9)
waypoints = [minsnap.Waypoint(time=float(second), position=[5 * np.cos(angle), 5 * np.sin(angle), 3]) for second, angle in enumerate(angles)]
path = minsnap.generate_trajectory(waypoints, degree=8, idx_minimized_orders=(3, 4), num_continuous_orders=3)
times_s = np.arange(1, 7, STEP_S)  # it rests at both ends, where a yaw that follows the path has no meaning


def off_deg(flight):
    """Return how far the body rates, added up, end from the last pose, and the first rates by them and by the poses."""
    poses = Rotation.from_quat(flight.attitude)
    flown = poses[0]
    for rate in (flight.body_rates[:-1] + flight.body_rates[1:]) / 2:
        flown *= Rotation.from_rotvec(rate * STEP_S)
    return np.degrees((flown.inv() * poses[-1]).magnitude()), flight.body_rates[0, 2], (poses[0].inv() * poses[1]).as_rotvec()[2] / STEP_S


followed = minsnap.compute_quadrotor_trajectory(path, times_s, vehicle_mass=1.0, yaw="velocity")
_, velocity, acceleration = minsnap.compute_trajectory_derivatives(path, times_s, 3)
yaw = np.arctan2(velocity[:, 1], velocity[:, 0])
yaw_rate = (velocity[:, 0] * acceleration[:, 1] - velocity[:, 1] * acceleration[:, 0]) / (velocity[:, :2] ** 2).sum(axis=1)
given = minsnap.compute_quadrotor_trajectory(path, times_s, vehicle_mass=1.0, yaw=yaw, yaw_rate=yaw_rate)
assert np.allclose(followed.attitude, given.attitude)
for name, flight in (("yaw follows the path", followed), ("yaw rate by hand", given)):
    end_deg, rate, turned = off_deg(flight)
    print(f"{name}: rate about the vertical {rate:.2f} rad/s, by the poses {turned:.2f}; flown by the rates it ends {end_deg:.1f} degrees off")
assert abs(off_deg(followed)[0] - 142) < 1 and off_deg(given)[0] < 0.5
PYTHON
