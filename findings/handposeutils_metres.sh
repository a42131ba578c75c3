#!/usr/bin/env bash
# A hand of 21 landmarks, as MediaPipe has them, is held flat with straight fingers. How bent are they? Angles do not depend on the unit of length.
# Guess: by 0 degrees, and 180 at the joints, in metres and in millimetres. Seen with handposeutils 0.1.7 on 2026-12-01, without a word:
#                                 metres (MediaPipe's world landmarks)   shares of the image's width   millimetres
#   bend of the index / little finger          3.1 / 4.0                         2.0 / 2.6                 0 / 0
#   last joint of the little finger             175.4                             177.0                    180
# A constant is added to products of lengths, against division by zero, which is a third of a percent of those of a fingertip in metres. Bends below 4 degrees cannot be told
# from straight, and a child's hand, or the same hand farther from the camera, is more bent.
# Of recorded hands: while the tracker has lost the hand, for 0.4 s here, the last pose is held without a mark (`stop_recording` stretches it), as long as it may be.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check handposeutils==0.1.7 numpy==2.4.6 2>/dev/null
cd "$folder"
venv/bin/python - <<'PYTHON'
import time

import numpy as np
from handposeutils.calculations.geometry import get_finger_curvature, get_joint_angle
from handposeutils.data.coordinate import Coordinate
from handposeutils.data.handpose import HandPose
from handposeutils.data.handpose_sequence import HandPoseSequence

FINGERS_M = [  # thumb to little finger: across, to the first joint, and the lengths of three bones
    (-0.050, 0.030, (0.035, 0.030, 0.025)),
    (-0.030, 0.090, (0.040, 0.025, 0.020)),
    (-0.010, 0.092, (0.045, 0.027, 0.020)),
    (0.010, 0.088, (0.040, 0.025, 0.020)),
    (0.030, 0.080, (0.032, 0.018, 0.017)),
]


def hand(scale):
    points = [(0.0, 0.0, 0.0)]
    for across, start, bones in FINGERS_M:
        points += [(across, along, 0.0) for along in np.cumsum([start, *bones])]
    return HandPose([Coordinate(*(scale * np.array(point))) for point in points], "right_hand")


seen = {}
for unit, scale in (("m", 1), ("image width", 1 / 0.64), ("mm", 1000)):
    pose = hand(scale)
    bends = [get_finger_curvature(finger, pose) for finger in ("INDEX", "PINKY")]
    seen[unit] = np.degrees([*bends, get_joint_angle((18, 19, 20), pose)]).round(1).tolist()
    print(f"{unit}: bends and last joint {seen[unit]}")
assert seen == {"m": [3.1, 4.0, 175.4], "image width": [2.0, 2.6, 177.0], "mm": [0, 0, 180]}, seen

poses = iter([hand(1)] * 3 + [None] * 20 + [hand(1)] * 3)
recorded = HandPoseSequence()
recorded.start_recording(lambda: next(poses, None), fps=50)
time.sleep(1)
recorded.stop_recording()
shown_s = [each.end_time - each.start_time for each in recorded.sequence]
print("each pose is shown for", np.round(shown_s, 2).tolist(), "s")
assert len(shown_s) == 6 and shown_s[2] > 0.35 and max(shown_s[:2]) < 0.2
PYTHON
