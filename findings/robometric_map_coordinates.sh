#!/usr/bin/env bash
# A vehicle drives a roundabout of 10 m twice, 25 times a second; its poses are in metres of a map, in float64, and its yaw is between -180 and 180 degrees, as it comes from
# quaternions. A prediction of it lies 10 cm to the east throughout. They are measured with robometric-frame, metrics of robots' paths for torchmetrics.
# Guess: 10 cm of absolute error, none of motions; 125.7 m of path; no change of curvature, as on a circle. Seen with robometric-frame 0.3.0 on 2026-11-30, without a word:
# - the change of curvature is 0.2 per metre, which is that of a zigzag: twice per turn the yaw jumps by 360 degrees, and angles are subtracted as numbers. Unwrapped: 0
# - in metres of UTM the path is 140.4 m, the error of motions 2.5 cm, the absolute one 10.5 cm, and the curvature, unwrapped, changes by 10568 per metre: float64 is made
#   float32, which there has steps of 6 and 50 cm
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check torch==2.13.0 2>/dev/null
venv/bin/pip install --quiet --disable-pip-version-check numpy==2.4.6 lightning-utilities==0.15.3 2>/dev/null
venv/bin/pip install --quiet --disable-pip-version-check --no-deps robometric-frame==0.3.0 torchmetrics==1.9.0 2>/dev/null
cat > metrics.py <<'PYTHON'
import math

import torch
from robometric_frame import AbsoluteTrajectoryError, CurvatureChange, PathLength, RelativeTrajectoryError

turned = torch.linspace(0, 4 * math.pi, 401, dtype=torch.float64)
path_m = 10 * torch.stack([torch.cos(turned), torch.sin(turned)], dim=-1)
yaw = turned + math.pi / 2
wrapped = torch.atan2(torch.sin(yaw), torch.cos(yaw))
east_m = torch.tensor([0.1, 0.0], dtype=torch.float64)


def measured(metric, *values):
    metric.update(*values)
    return round(metric.compute().item(), 4)


found = {}
for place, origin_m in (("here", [0.0, 0.0]), ("UTM", [692_000.0, 5_337_000.0])):
    true_m = path_m + torch.tensor(origin_m, dtype=torch.float64)
    found[place] = {
        "absolute": measured(AbsoluteTrajectoryError(), true_m + east_m, true_m),
        "motions": measured(RelativeTrajectoryError(), true_m + east_m, true_m),
        "length": measured(PathLength(), true_m),
        "curvature": measured(CurvatureChange(), true_m, yaw),
    }
    print(place, found[place])
    assert true_m.dtype == torch.float64
change = measured(CurvatureChange(), path_m, wrapped)
print("change of curvature on the circle:", change, "where the yaw is within 180 degrees")
assert found["here"] == {"absolute": 0.1, "motions": 0, "length": 125.6586, "curvature": 0} and abs(change - 0.2) < 0.01
assert found["UTM"]["motions"] == 0.025 and found["UTM"]["absolute"] > 0.104 and found["UTM"]["length"] > 140 and found["UTM"]["curvature"] > 10_000
PYTHON
venv/bin/python metrics.py > metrics.txt 2>&1 || { cat metrics.txt; exit 1; }
cat metrics.txt
if grep -i warn metrics.txt; then exit 1; fi
