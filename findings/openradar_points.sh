#!/usr/bin/env bash
# An xWR1843 sees two cars, one coming at 8 m/s and one leaving at 6 m/s, as points that are clustered; and a reflector at its own height, at azimuths of 0 to 20
# degrees, whose place is estimated from its 12 virtual antennas. Guess: each cluster has the velocity of its points; the elevation is 0 each time.
# Seen with openradar 1.0.1 on 2026-11-30, without a word:
# - `radar_dbscan`: `avgVelocity` is the mean of ALL points of the frame, so both clusters have -2.4 m/s
# - `naive_xyz`: elevation 0 at the azimuth of 0, but -16 degrees at 10, 22 at 15 and 14 at 20. The azimuth's FFT has 64 bins, the elevation's 4, since the padded array that is
#   made for it is not used; the phases that are compared are of different bins
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check --no-deps openradar==1.0.1 2>/dev/null
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check numpy==1.26.4 scipy==1.13.1 scikit-learn==1.5.2 matplotlib==3.9.4 2>/dev/null
cd "$folder"
venv/bin/python -W ignore - <<'PYTHON'
import numpy as np
from mmwave.clustering import radar_dbscan
from mmwave.dsp import naive_xyz

STEP = 0.1  # m/s of a Doppler bin
rows = [(10, -80, 100, x, 5.0, 0.0) for x in (0.0, 0.2, 0.4)] + [(40, 60, 100, x, 20.0, 0.0) for x in (3.0, 3.2)]  # range bin, Doppler bin, peak, x, y, z
clusters = radar_dbscan(np.array(rows), 0, STEP, use_elevation=True)
for cluster in clusters:
    print(f"{cluster['num_points']} points at {cluster['center'].round(1).tolist()}: {cluster['avgVelocity']:.1f} m/s")
assert clusters["num_points"].tolist() == [3, 2] and np.allclose(clusters["avgVelocity"], np.mean([row[1] for row in rows]) * STEP)

for azimuth, wrong in ((0, 0), (10, -16), (15, 22), (20, 14)):
    phase = np.pi * np.sin(np.radians(azimuth))  # between antennas half a wavelength apart; those of elevation stand above the third to sixth
    signal = np.exp(1j * phase * np.concatenate((np.arange(8), np.arange(2, 6))))[:, None]
    x, _, z = naive_xyz(signal)
    at, elevation = np.degrees(np.arcsin((x[0], z[0])))
    print(f"azimuth {azimuth}: estimated {at:.1f}, elevation {elevation:.1f} degrees")
    assert abs(at - azimuth) < 2 and abs(elevation - wrong) < 1
PYTHON
