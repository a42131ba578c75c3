#!/usr/bin/env bash
# Field reports and maps of off-road robots have grid references (MGRS): 32U PU 860 330 is a square of 100 m, near Munich. It becomes latitude and longitude, and
# metres of UTM, for a map or a goal. Which point of the square? Guess: its south-west corner, as digits of a reference are cut, not rounded.
# Seen on 2026-11-29, without a word:
#   mgrs 1.5.4, by `toLatLon` and `MGRSToUTM`        the corner, 686000 and 5333000
#   mgrs 1.6.0, by both                              the CENTRE, 686050 and 5333050: the same call, one version later
#   pygeodesy 26.10.26                               the corner by `toUtm`, the centre by `toLatLon`, of one object
#   mgrs 2.2.0 of npm, `toPoint`                     the centre
# So positions differ by 71 m, or by 7 km for a reference of 10 km, and by 0.7 m for one of a metre, which is more than the precision of the receiver.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check pygeodesy==26.10.26 pyproj==3.7.2 packaging==26.0
for version in 1.5.4 1.6.0; do
  "$folder/venv/bin/pip" install --quiet --disable-pip-version-check --target "$folder/$version" mgrs==$version
done
cd "$folder"
npm install --silent --no-fund --no-audit --prefix "$folder" mgrs@2.2.0
cat > place.py <<'PYTHON'
import sys

import mgrs
from pyproj import Proj

converter, utm = mgrs.MGRS(), Proj(proj="utm", zone=32, ellps="WGS84")
for reference, size_m in (("32UPU860330", 100), ("32UPU83", 10_000), ("32UPU8600033000", 1)):
    zone, hemisphere, east_m, north_m = converter.MGRSToUTM(reference)
    latitude, longitude = converter.toLatLon(reference)
    by_angles_m = utm(longitude, latitude)
    corner_m = (680_000, 5_330_000) if size_m == 10_000 else (686_000, 5_333_000)
    shares = [round((at - corner) / size_m, 2) for at, corner in zip((east_m, north_m, *by_angles_m), corner_m * 2)]
    print(f"{sys.argv[1]}: {reference} is {east_m}, {north_m}: {shares} of the square")
    assert shares == [float(sys.argv[2])] * 4
PYTHON
PYTHONPATH=1.5.4 venv/bin/python place.py 1.5.4 0
PYTHONPATH=1.6.0 venv/bin/python place.py 1.6.0 0.5
venv/bin/python - "$(node -p 'JSON.stringify(require("mgrs").toPoint("32UPU860330"))')" <<'PYTHON'
import json
import sys

from pygeodesy import parseMGRS
from pyproj import Proj

utm = Proj(proj="utm", zone=32, ellps="WGS84")
reference = parseMGRS("32UPU860330")
place = reference.toLatLon()
by_metres, by_angles, of_npm = (reference.toUtm().easting, reference.toUtm().northing), utm(place.lon, place.lat), utm(*json.loads(sys.argv[1]))
print(f"pygeodesy: {by_metres}, {by_angles}; npm: {of_npm}")
assert by_metres == (686_000, 5_333_000)
for east_m, north_m in (by_angles, of_npm):
    assert abs(east_m - 686_050) < 0.05 and abs(north_m - 5_333_050) < 0.05
PYTHON
