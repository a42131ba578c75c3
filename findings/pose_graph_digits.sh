#!/usr/bin/env bash
# Two poses of a survey in UTM, 10 cm apart at a northing of 5,330,004.654 m, are in a pose graph. It is saved in g2o's format, which SLAM programs
# exchange, and read again. Where are they? Guess: where they were, as text has room for all digits, or to the millimetre.
# Seen on 2026-11-29, without a word:
#   gtsam 4.3.0 (`writeG2o`), g2opy 2.3.0 (g2o's own `save`)   at a northing of 5,330,000 m and an easting of whole metres, both at the SAME place: each number
#                                                              has six digits, whatever its size
#   graphslam 0.0.17                                           where they were, to the last digit
# Edges, being short, keep what counts, so the graph fits together again once it is optimized; but it hangs on its first pose, 4.7 m from where it was.
# With coordinates that begin at the first pose, steps are 1 cm a kilometre away.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check --no-deps gtsam==4.3.0 g2opy==2.3.0 graphslam==0.0.17 numpy==2.4.6 scipy==1.17.1
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check matplotlib==3.11.2 numpy==2.4.6
cd "$folder"
cat > save.py <<'PYTHON'
import sys
from pathlib import Path

import numpy as np

PLACES_M = np.array([[691234.123, 5330004.654, 520.25], [691234.223, 5330004.654, 520.25]])
INFORMATION = " ".join("1" if row == column else "0" for row in range(6) for column in range(row, 6))

vertices = "".join(f"VERTEX_SE3:QUAT {number} {x} {y} {z} 0 0 0 1\n" for number, (x, y, z) in enumerate(PLACES_M))
Path("graph.g2o").write_text(f"{vertices}EDGE_SE3:QUAT 0 1 0.1 0 0 0 0 0 1 {INFORMATION}\n")

if sys.argv[1] == "gtsam":
    import gtsam

    graph, poses = gtsam.readG2o("graph.g2o", True)
    read = np.array([poses.atPose3(number).translation() for number in (0, 1)])
    gtsam.writeG2o(graph, poses, "saved.g2o")
elif sys.argv[1] == "g2opy":
    import g2opy

    optimizer = g2opy.SparseOptimizer()
    assert optimizer.load("graph.g2o")
    read = np.array([optimizer.vertex(number).estimate().translation() for number in (0, 1)])
    assert optimizer.save("saved.g2o")
else:
    from graphslam.load import load_g2o

    graph = load_g2o("graph.g2o")
    read = np.array([vertex.pose.to_array()[:3] for vertex in graph._vertices])
    graph.to_g2o("saved.g2o")
assert np.allclose(read, PLACES_M, rtol=0, atol=1e-9)
rows = [line.split() for line in Path("saved.g2o").read_text().splitlines() if line.startswith("VERTEX")]
saved = np.array([row[2:5] for row in rows], float)
print(f"{sys.argv[1]}: {' and '.join(' '.join(row[2:5]) for row in rows)}")
if sys.argv[1] == "graphslam":
    assert np.array_equal(saved, PLACES_M)
else:
    assert saved.tolist() == [[691234, 5330000, 520.25]] * 2
PYTHON
for program in gtsam g2opy graphslam; do venv/bin/python save.py "$program"; done
