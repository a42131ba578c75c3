#!/usr/bin/env bash
# A lorry, 10 m long and 2.5 wide, is labelled; a detector finds it 2 m too far ahead, another one 1 m too far to the left. Three numbers of nucleus, Scale's library, judge
# them: CuboidIOU, CuboidPrecision and CuboidRecall, with an overlap of 0.5 as the limit. In a cuboid, dimensions are "length (x), width (y), and height (z)", turned by yaw.
# Guess: overlaps of 8/12 and 1.5/3.5; so the first is right by all of them, the second by none.
# Seen with scale-nucleus 0.22.3 on 2026-11-30, without a word: the overlaps are these, 0.67 and 0.43, whichever way the lorry heads. But by precision and recall it is the
# other way round, 0 for the first and 1 for the second: there boxes are turned by a quarter more, so that the lorry lies across its heading, and errors
# ahead are judged as those to the side
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check "scale-nucleus[metrics]==0.22.3" numpy==2.4.6
venv/bin/python -W ignore - <<'PYTHON'
import numpy as np
from nucleus import CuboidAnnotation, CuboidPrediction, Point3D
from nucleus.metrics import CuboidIOU, CuboidPrecision, CuboidRecall

SIZE = Point3D(10.0, 2.5, 3.0)
ERRORS = {"2 m ahead": (2.0, 0.0), "1 m to the left": (0.0, 1.0)}
EXPECTED = {"2 m ahead": (8 / 12, 0, 0), "1 m to the left": (1.5 / 3.5, 1, 1)}
for yaw in (0.0, 0.5, np.pi / 2):
    ahead, left = np.array([np.cos(yaw), np.sin(yaw)]), np.array([-np.sin(yaw), np.cos(yaw)])
    label = CuboidAnnotation("lorry", Point3D(0, 0, 0), SIZE, yaw, "frame")
    for name, (ahead_m, left_m) in ERRORS.items():
        x_m, y_m = ahead_m * ahead + left_m * left
        found = CuboidPrediction("lorry", Point3D(x_m, y_m, 0), SIZE, yaw, "frame", confidence=0.9)
        overlap = CuboidIOU().eval([label], [found]).value
        right = [metric(iou_threshold=0.5).eval([label], [found]).value for metric in (CuboidPrecision, CuboidRecall)]
        print(f"yaw {yaw:.2f}, {name}: overlap {overlap:.2f}, precision and recall {right}")
        assert np.allclose([overlap, *right], EXPECTED[name], atol=1e-3)
PYTHON
