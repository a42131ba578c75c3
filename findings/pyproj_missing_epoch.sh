#!/usr/bin/env bash
# A receiver near Munich has its corrections from a service in ITRF2014 (EPSG:7912); its fixes shall go onto a map in ETRS89 (EPSG:4937), which
# moves with Europe, by 2.5 cm a year. What does pyproj make of a fix without a time, and of one "in WGS 84"?
# Guess: an error for want of a time, or today's. Seen with pyproj 3.7.2 on 2026-11-29, without a word:
# - without a time, as all examples call `transform`: that of 2015.0, 0.65 m away; at the end of 2026 it is 0.95 m, so the drive is 0.3 m off
# - with the year as fourth argument, (latitude, longitude, height, 2026.9): right. Seconds since 1970 in its place are taken for a year.
# - from WGS 84 (EPSG:4979), as most recordings have it: not moved at all, at any time; the fix is 0.95 m off. `accuracy` says 1 m.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check pyproj==3.7.2
cd "$folder"
venv/bin/python - <<'PYTHON'
from math import cos, hypot, radians

from pyproj import Transformer

FIX = (48.1, 11.5, 500.0)


def moved_m(system, *year):
    """Return how far a fix is moved on its way into ETRS89."""
    latitude, longitude, *_ = Transformer.from_crs(system, "EPSG:4937").transform(*FIX, *year)
    return hypot((latitude - FIX[0]) * 111_200, (longitude - FIX[1]) * 111_320 * cos(radians(FIX[0])))


none, in_2015, in_2026 = moved_m("EPSG:7912"), moved_m("EPSG:7912", 2015.0), moved_m("EPSG:7912", 2026.9)
wgs84 = moved_m("EPSG:4979"), moved_m("EPSG:4979", 2026.9)
print(f"from ITRF2014: without a time {none:.3f} m, 2015.0 {in_2015:.3f} m, 2026.9 {in_2026:.3f} m; from WGS 84: {wgs84}")
print(f"seconds since 1970: {moved_m('EPSG:7912', 1.79e9):.0f} m")
assert abs(none - in_2015) < 1e-6
assert abs(none - 0.65) < 0.01 and abs(in_2026 - 0.95) < 0.01
assert wgs84 == (0.0, 0.0)
assert moved_m("EPSG:7912", 1.79e9) > 1e6
assert Transformer.from_crs("EPSG:4979", "EPSG:4937").accuracy == 1.0
PYTHON
