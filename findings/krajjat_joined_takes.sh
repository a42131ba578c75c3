#!/usr/bin/env bash
# A hand moves at 1 m/s, as motion capture at 100 Hz in two takes of 10 s: `concatenate` joins them, `get_measure` has velocity and path, `resample_data` goes to 50 Hz.
# Guess: as its help says: joined, the second take follows by one period, 0.01 s, and is left as it was; 1 m/s; 1 m in the first second; values at their times.
# Seen with krajjat 1.99.24 on 2026-12-01, without a word:
# - `concatenate`: a pause of 100 s, as many seconds as there are hertz: the joined 20 s last 119.98. And the poses of the second take are those of the joined one, so
#   its times have changed, too: it starts at 109.99 s by its own account
# - velocity: 0.5 m/s in the first and the last pose, 0.76 and 0.96 next to them: beyond its ends the hand is taken to stand still
# - path within the first second ("distance" with `timestamp_end=1`): 1.01 m, the step that leaves it counted
# - `resample_data` of samples whose times start at 5 s: the SECOND half of the values at the times of the first, and zeros from there on. Sequences escape, since
#   they are resampled by times from 0 on
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check krajjat==1.99.24 joblib==1.5.3 numpy==2.4.6 scipy==1.17.1 2>/dev/null
cd "$folder"
venv/bin/python - <<'PYTHON'
import numpy as np
from krajjat.classes.joint import Joint
from krajjat.classes.pose import Pose
from krajjat.classes.sequence import Sequence
from krajjat.tool_functions import resample_data

TIMES_S = np.round(np.arange(0, 10, 0.01), 6)


def take(start_s):
    sequence = Sequence(time_unit="s", verbosity=0)
    for time_s in TIMES_S:
        pose = Pose(start_s + time_s)
        pose.add_joint(Joint("Hand", time_s, 0.0, 0.0))
        sequence.add_pose(pose, verbosity=0)
    return sequence


first, second = take(0), take(0)
velocity = first.get_measure("velocity", "Hand")
print("velocity:", np.round([*velocity[:4], velocity[500], *velocity[-2:]], 3).tolist())
assert np.allclose(velocity[[0, 1, 2, 500, -1]], [0.5, 0.757, 0.957, 1, 0.5], atol=1e-3)
path_m = first.get_measure("distance", "Hand", timestamp_start=0, timestamp_end=1).sum()
print("path in the first second:", round(path_m, 6))
assert np.isclose(path_m, 1.01)

joined = first.concatenate(second)
joined_s = np.array(joined.get_timestamps())
print("joined:", len(joined_s), "poses,", joined_s[[0, 999, 1000, -1]].round(6).tolist(), "and the second take starts at", second.get_timestamps()[0])
assert np.allclose(joined_s[[0, 999, 1000, -1]], [0, 9.99, 109.99, 119.98])
assert np.isclose(second.get_timestamps()[0], 109.99)

values, times_s = resample_data(TIMES_S + 5, TIMES_S + 5, 50, method="linear", verbosity=0)
print("values at", times_s[[0, 1, 249, 250, -1]].round(6).tolist(), "are", values[[0, 1, 249, 250, -1]].round(6).tolist())
assert np.allclose(times_s, 5 + np.arange(500) / 50)
assert np.allclose(values[:250], times_s[250:]) and not values[250:].any()
PYTHON
