#!/usr/bin/env bash
# A scan in UTM coordinates, float64, is written to E57, a format for surveying, with pye57, and read again. What changes?
# Guess: nothing, as E57 has doubles and the arrays that go in and come out are float64.
# Seen with pye57 0.4.19 on 2026-11-29, without a word:
# - coordinates are stored in single precision: a northing of 5,330,000.654 m comes back as 5,330,000.5, still as float64. A scan around
#   its sensor, with the large numbers in `translation`, keeps them.
# - `sphericalRange` beside x, y, z, a field that it knows and reads, is not written; nor are red and green without blue
# - `read_scan` leaves out points with `cartesianInvalidState`, so that they are fewer than in what was written; `read_scan_raw` has all.
#   Arrays kept beside the file (labels, times) are off by the number of those before.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check pye57==0.4.19 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import numpy as np
from pye57 import E57

EAST_M, NORTH_M, UP_M = 690_000.123, 5_330_000.654, 500.123
around = {f"cartesian{axis}": np.array([0.0, 1.25, 2.5, 3.75]) for axis in "XYZ"}
scan = {name: values + offset for (name, values), offset in zip(around.items(), (EAST_M, NORTH_M, UP_M))}
more = {
    "cartesianInvalidState": np.array([0, 2, 0, 0], np.int8),
    "sphericalRange": np.arange(4.0),
    "colorRed": np.arange(4, dtype=np.uint8),
    "colorGreen": np.arange(4, dtype=np.uint8),
}
file = E57("scans.e57", mode="w")
file.write_scan_raw(scan | more)
file.write_scan_raw(around, rotation=np.array([1.0, 0, 0, 0]), translation=np.array([EAST_M, NORTH_M, UP_M]))
file.close()

file = E57("scans.e57")
raw, valid, placed = file.read_scan_raw(0), file.read_scan(0, ignore_missing_fields=True), file.read_scan(1, ignore_missing_fields=True)
print(f"{raw['cartesianY'].dtype}: {raw['cartesianY'][0]}; by translation {placed['cartesianY'][0]}; fields {sorted(raw)}")
print(f"{len(raw['cartesianX'])} points, of which read_scan reads {len(valid['cartesianX'])}")
assert raw["cartesianY"].dtype == np.float64
assert raw["cartesianY"][0] == np.float32(NORTH_M) == 5_330_000.5
assert np.allclose(placed["cartesianY"], scan["cartesianY"], atol=1e-6)
assert sorted(raw) == ["cartesianInvalidState", "cartesianX", "cartesianY", "cartesianZ"]
assert (len(raw["cartesianX"]), len(valid["cartesianX"])) == (4, 3)
PYTHON
