#!/usr/bin/env bash
# A simulated lidar, or a generator of clouds, is compared with real clouds by pc-metrics: Chamfer distance (CD), earth mover's distance (EMD), Jensen-Shannon divergence (JSD).
# Guess: 0 for equal clouds; for a cloud that is moved by d, an EMD of d, as each point has to be carried that far; a JSD of 0 for equal sets alone.
# Seen with pc-metrics 0.2.5 and torch 2.13.0 on 2026-11-30, without a word:
# - JSD is 0 for ANY two sets: of two distributions their entropies, two numbers, are compared
# - EMD is 2.7 m of a cloud of 20 m that is moved by 5 m; up to 1 m it is right: it stops after 100 steps, with half of the cloud still to be carried
# - CD of a cloud to itself is 6 cm in a map, 2 km from its origin, and 5 mm within 100 m around a lidar: distances are the differences of large squares, in float32, as soon
#   as there are more than 25 points (torch.cdist); of 20 points, and with `gpu=False`, it is 0
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check torch==2.13.0 2>/dev/null
venv/bin/pip install --quiet --disable-pip-version-check scikit-learn==1.9.1 scipy==1.17.1 numpy==2.4.6 2>/dev/null
venv/bin/pip install --quiet --disable-pip-version-check --no-deps pc-metrics==0.2.5 2>/dev/null
cat > distances.py <<'PYTHON'
import numpy as np
from pc_metrics import CD, EMD, JSD

random = np.random.default_rng(0)
wide, narrow = random.uniform(-0.4, 0.4, (5, 200, 3)), random.uniform(-0.1, 0.1, (5, 200, 3))
print(f"JSD of two different sets: {JSD(wide, narrow)}")
assert JSD(wide, narrow) == JSD(wide, wide) == 0

room_m = random.uniform(-10, 10, (300, 3))
carried_m = {metres: EMD(room_m, room_m + [metres, 0, 0]) for metres in (0.1, 1, 5)}
print("EMD of a cloud that is moved:", {metres: round(found, 3) for metres, found in carried_m.items()})
assert np.allclose([carried_m[0.1], carried_m[1]], [0.1, 1], atol=0.01) and carried_m[5] < 3

off_m = {}
for name, cloud in {
    "20 m around the origin": random.uniform(-20, 20, (2000, 3)),
    "100 m around the origin": random.uniform(-100, 100, (2000, 3)),
    "in a map": random.uniform(-20, 20, (2000, 3)) + [1000, 2000, 0],
}.items():
    off_m[name] = CD(cloud, cloud)
    assert CD(cloud[:20], cloud[:20]) == CD(cloud[None], cloud[None], gpu=False) == 0
print("CD of a cloud to itself, in metres:", {name: round(found, 4) for name, found in off_m.items()})
assert off_m["in a map"] > 0.03 and off_m["100 m around the origin"] > 0.001
PYTHON
venv/bin/python distances.py > distances.txt 2> said.txt || { tail -5 said.txt; exit 1; }
cat distances.txt
if grep -i warn said.txt; then exit 1; fi
