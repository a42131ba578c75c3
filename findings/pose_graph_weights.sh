#!/usr/bin/env bash
# A pose graph is a file of g2o's format (EDGE_SE3:QUAT), which most SLAM programs write and read. An edge says "1 m ahead, not turned", with an
# information of 60 about z; the two poses are turned by 0.1 rad about z. What is the error of this edge (chi2), by three programs?
# Guess: 60 * 0.1^2 = 0.6 by all, as the information is in 1/rad2. Seen on 2026-11-29, of one file:
#   g2opy 2.3.0 (g2o itself), graphslam 0.0.17   0.15
#   gtsam 4.3.0                                  0.6
# g2o takes the vector part of the quaternion for the error, which is HALF the angle, and so must the information be of half angles; gtsam puts
# the 6 x 6 numbers into its own order (rotation first) as they are, for angles. So whoever writes a covariance in radians for g2o has
# rotations that count a quarter of what they should, in one program, and a file that g2o wrote turns four times as stiff in gtsam.
# Nothing is said; the answer of an optimization shifts between rotation and translation. Where all edges are of one kind, it hardly shows.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check --no-deps \
  gtsam==4.3.0 g2opy==2.3.0 graphslam==0.0.17 numpy==2.4.6 scipy==1.17.1
cd "$folder"
cat > edge.py <<'PYTHON'
import math
import sys
from pathlib import Path

import numpy as np

HALF = 0.1 / 2
VERTICES = f"VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\nVERTEX_SE3:QUAT 1 1 0 0 0 0 {math.sin(HALF)} {math.cos(HALF)}\n"
UPPER = [information for row in range(6) for information in [10 * (row + 1)] + [0] * (5 - row)]  # 10, 20, … 60 on the diagonal
Path("graph.g2o").write_text(f"{VERTICES}EDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1 {' '.join(map(str, UPPER))}\n")

if sys.argv[1] == "g2opy":
    import g2opy

    optimizer = g2opy.SparseOptimizer()
    assert optimizer.load("graph.g2o")
    (edge,) = optimizer.edges()
    edge.compute_error()
    assert np.isclose(edge.error[5], math.sin(HALF))
    chi2, expected = edge.chi2(), 60 * math.sin(HALF) ** 2
elif sys.argv[1] == "graphslam":
    from graphslam.load import load_g2o

    chi2, expected = load_g2o("graph.g2o").calc_chi2(), 60 * math.sin(HALF) ** 2
else:
    import gtsam

    graph, poses = gtsam.readG2o("graph.g2o", True)
    information = np.diag(graph.at(0).noiseModel().information())
    assert np.allclose(information, [40, 50, 60, 10, 20, 30])  # the same numbers, rotation first
    chi2, expected = 2 * graph.error(poses), 60 * 0.1**2
print(f"{sys.argv[1]}: chi2 {chi2:.4f}")
assert np.isclose(chi2, expected)
PYTHON
for program in g2opy graphslam gtsam; do venv/bin/python edge.py "$program"; done
