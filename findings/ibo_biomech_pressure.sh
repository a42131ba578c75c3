#!/usr/bin/env bash
# A foot stands for a second on a force plate, 1.5 m from the origin, and is in the air before and after: there its centre of pressure is unknown, NaN. The recording is smoothed
# with `lowpass_filter(20)`, as forces of walking are, and what is unloaded is taken out with `filter_low_forces(10)`. Where is the centre of pressure?
# Guess: at 1.5 m, while the foot is on the plate. Seen with ibo-biomech 0.3.9 on 2026-12-01, without a word:
# - at touch-down, when 125 N are on the plate, at 0.78 m; 5 ms later at 1.02, 20 ms later at 1.57, and up to 1.60. The same backwards at lift-off
# - 10 ms before touch-down, where the smoothed force is 16 N, at 0.17 m: the point travels from the origin to the foot
# NaN of the centre are zeros as soon as the plate is made, and the centre is smoothed as if it were a signal of its own. Of the smoothed force and moment it is 1.5 m throughout
# (1.500 here, to a thousandth). `downsample` takes the centre through a filter alike
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check ibo-biomech==0.3.9 numpy==2.4.6 scipy==1.17.1 2>/dev/null
cd "$folder"
venv/bin/python - <<'PYTHON'
import numpy as np
from ibo_biomech.containers.forceData import ForceData

RATE_HZ, FOOT_MM = 1000, np.array([1500.0, 400.0, 0.0])
times_s = np.arange(3 * RATE_HZ) / RATE_HZ
down_n = np.where((times_s >= 1) & (times_s < 2), 800 * np.sin(np.pi * np.clip(times_s - 1, 0, 1)) ** 0.3, 0)
force_n = np.stack([0 * down_n, 0 * down_n, down_n])
moment_nmm = np.cross(FOOT_MM, force_n.T).T
centre_mm = np.where(down_n > 0, FOOT_MM[:, None], np.nan)
plate = ForceData(
    "plate", force=force_n, moment=moment_nmm, cop=centre_mm, sampling_rate=RATE_HZ, metadata={"unit_force": "N", "unit_moment": "Nmm", "unit_position": "mm"}
)
assert plate.cop[0, 500] == 0 and plate.cop[0, 1500] == 1500
plate.lowpass_filter(20)
plate.filter_low_forces(10)
of_moment_mm = -plate.moment[1] / np.where(plate.force[2] == 0, np.nan, plate.force[2])
for late_ms in (-10, 1, 5, 20, 500):
    at = RATE_HZ + late_ms
    print(f"{late_ms:4} ms after touch-down: {plate.force[2, at]:5.0f} N at {plate.cop[0, at] / 1000:.2f} m, by force and moment at {of_moment_mm[at] / 1000:.3f} m")
seen_mm = plate.cop[0, RATE_HZ + np.array([-10, 1, 5, 20])]
assert np.allclose(seen_mm, [175, 781, 1021, 1571], atol=1), seen_mm
assert np.isclose(plate.force[2, RATE_HZ + 1], 125, atol=1)
assert np.isclose(plate.cop[0].max(), 1602, atol=1)
loaded = plate.force[2] > 0
assert loaded[990:2010].all() and np.allclose(of_moment_mm[loaded], 1500, atol=1)
PYTHON
