#!/usr/bin/env bash
# A car drives a quarter of a circle, 5 m/s, with odometry as in ROS (twist in the frame of the car) and GNSS. ArrayDataEngine is to resample, transform and
# integrate it. Guess: headings between those before and after; a velocity ahead stays one ahead in whichever map; the arc back; 1 km is 1 km.
# Seen with arraydataengine 0.3.1 on 2026-11-30, without a word:
# - `resample_topic` to twice the rate, "linear" by default: between 179.5 and 180.5 degrees the heading is 0, of a quaternion 0.004 long, since those with
#   w >= 0 differ in sign there. Its `resample_odometry` has 180
# - `transform_odometry` into a map that is turned by 90 degrees turns the twist, too: the car drives sideways
# - `odometry_to_trajectory`, then `dead_reckon_trajectory`: a straight line, since the twist is taken as one in the world. `body_frame_velocity=True` has the arc
# - `navsat_to_enu` is of a sphere with the radius of the equator: 1 km north is 1007 m at the equator
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3.12 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check arraydataengine==0.3.1 numpy==2.4.6 pyproj==3.7.2 2>/dev/null
cd "$folder"
venv/bin/python - <<'PYTHON'
import numpy as np
from arraydataengine.ops import core, geometry, nav
from pyproj import Geod

SPEED, TURN, RATE, BEGIN = 5.0, np.radians(10), 10, 135.5  # m/s, rad/s, Hz, degrees
stamps = np.arange(9 * RATE + 1) / RATE
headings = np.radians(BEGIN) + TURN * stamps
radius = SPEED / TURN
path = radius * np.stack((np.sin(headings) - np.sin(headings[0]), np.cos(headings[0]) - np.cos(headings)), 1)
odometry = np.zeros((len(stamps), 8, 4))  # rows, as the package has them: 0 position, 2 orientation, 4 linear and 6 angular velocity
odometry[:, 0, :2] = path
quaternions = np.stack((np.sin(headings / 2), np.cos(headings / 2)), 1)
quaternions[quaternions[:, 1] < 0] *= -1
odometry[:, 2, 2:] = quaternions
odometry[:, 4, 0], odometry[:, 6, 2] = SPEED, TURN


def heading(quaternion):
    """Return the heading, in degrees from 0 to 360."""
    return round(float(np.degrees(nav.quaternion_to_euler(quaternion)[..., 2])) % 360, 1)


topic = {"ts": stamps, "data": odometry, "id": np.arange(len(stamps))}
at = 2 * int(np.searchsorted(headings, np.pi)) - 1
resampled = core.resample_topic(topic, rate_hz=2 * RATE)["data"]
right = nav.resample_odometry(topic, period=0.5 / RATE)["orientation"][at]
seen = [heading(resampled[index, 2]) for index in (at - 1, at, at + 1)]
norm = np.linalg.norm(resampled[at, 2])
print(f"headings {seen}, norm {norm:.3f} in the middle; by resample_odometry {heading(right)}")
assert seen == [179.5, 0, 180.5] and norm < 0.01 and abs(heading(right) - 180) < 1

turned = np.eye(4)
turned[:2, :2] = [[0, -1], [1, 0]]
moved = geometry.transform_odometry(odometry, turned)
print(f"twist {odometry[0, 4, :2].tolist()}, in the turned map {moved[0, 4, :2].round(3).tolist()}; heading {heading(odometry[0, 2])}, then {heading(moved[0, 2])}")
assert np.allclose(moved[0, 4, :2], (0, SPEED)) and heading(moved[0, 2]) == BEGIN + 90

trajectory = nav.odometry_to_trajectory(topic)
straight = nav.dead_reckon_trajectory(trajectory)["position"][:, :2]
arc = nav.dead_reckon_trajectory(trajectory, body_frame_velocity=True)["position"][:, :2]
print(f"end {path[-1].round(1)}, reckoned {straight[-1].round(1)}, with body_frame_velocity {arc[-1].round(1)}")
assert np.allclose(straight[:, 0], SPEED * stamps) and np.allclose(straight[:, 1], 0) and np.allclose(arc[-1], path[-1], atol=0.1)

lon, lat, _ = Geod(ellps="WGS84").fwd(20, 0, 0, 1000)
north = float(nav.navsat_to_enu(lat, lon, 0.0, 0.0, 20.0)[1])
print(f"1000 m to the north are {north:.1f} m")
assert 1006 < north < 1008
PYTHON
