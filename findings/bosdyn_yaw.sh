#!/usr/bin/env bash
# Poses of a Spot are recorded, of its body and of its hand, and for a table their orientation becomes roll, pitch and yaw, by the methods that the robot's own SDK has:
# `to_roll`, `to_pitch`, `to_yaw`. The body, on a slope, is turned by 0.5 rad (28.6 degrees), then pitched by 0.2, then rolled by 0.3, and so on for the hand.
# Guess: these three angles, as ROS has them. Seen with bosdyn-client 5.2.0 on 2026-11-29, without a word: roll and pitch are those three's, yaw is another thing.
#   the body on the slope                                      0.3, 0.2, and 0.470 in place of 0.5: 1.7 degrees
#   the hand, turned by 0.5, pitched by 0.8, rolled by 1.2     1.2, 0.8, and -0.063: 32 degrees
# `to_yaw` is the turn about the vertical that comes nearest to the orientation, which is that yaw only for a level robot: put together, the three give another
# orientation. `quat_to_eulerZYX` of the same module has all three (yaw, pitch, roll).
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check bosdyn-client==5.2.0 scipy==1.17.1
"$folder/venv/bin/python" - <<'PYTHON'
import numpy as np
from bosdyn.client.math_helpers import Quat, quat_to_eulerZYX
from scipy.spatial.transform import Rotation

for name, yaw, pitch, roll, seen in (("level", 0.5, 0.0, 0.0, 0.5), ("slope", 0.5, 0.2, 0.3, 0.4697), ("hand", 0.5, 0.8, 1.2, -0.0631)):
    x, y, z, w = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_quat()
    orientation = Quat(w, x, y, z)
    got = [orientation.to_roll(), orientation.to_pitch(), orientation.to_yaw()]
    turn = Rotation.from_euler("ZYX", got[::-1]).inv() * Rotation.from_quat([x, y, z, w])
    print(f"{name}: roll, pitch, yaw {np.round(got, 3)}; put together {np.degrees(turn.magnitude()):.1f} degrees off")
    assert np.allclose(got, [roll, pitch, seen], atol=1e-3), got
    assert np.allclose(quat_to_eulerZYX(orientation), [yaw, pitch, roll])
PYTHON
