#!/usr/bin/env bash
# A drive crosses the border of two UTM zones (12 degrees east), or the equator. Does the utm package give a list of fixes what it gives
# each of them? Guess: yes, arrays are there for speed. Seen with utm 0.9.0 on 2026-11-28: no.
# - An array gets the zone of its FIRST fix throughout, and only one zone comes back; fix by fix the easting jumps by 447 km between two
#   fixes 15 m apart. So a node that converts messages as they come, and a script that converts the drive, disagree after the border.
# - Past the date line the array goes on in zone 60, with eastings (829 km) that no zone has; fix by fix it is zone 1.
# - Across the equator an array is refused, whole, while fix by fix the northing jumps by 10,000 km.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check utm==0.9.0 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import numpy as np
import utm

latitudes, longitudes = np.full(2, 48.0), np.array([11.9999, 12.0001])
easting, _, zone, _ = utm.from_latlon(latitudes, longitudes)
alone = [utm.from_latlon(*fix) for fix in zip(latitudes, longitudes, strict=True)]
print("together:", zone, easting.round(1), "one by one:", [(one[2], round(float(one[0]), 1)) for one in alone])
together_m, alone_m = easting[1] - easting[0], alone[1][0] - alone[0][0]
past = utm.from_latlon(np.full(2, 10.0), np.array([179.9999, -179.9999]))
print("date line:", past[2], past[0].round(1), "alone:", utm.from_latlon(10.0, -179.9999)[2])
try:
    utm.from_latlon(np.array([1e-4, -1e-4]), np.full(2, 11.0))
    refused = None
except ValueError as error:
    refused = str(error)
northing_m = [float(utm.from_latlon(latitude, 11.0)[1]) for latitude in (1e-4, -1e-4)]
print("equator:", refused, "alone:", northing_m)
seen = (
    zone, round(together_m), [one[2] for one in alone], round(alone_m / 1000), past[2], round(past[0][1] / 1000),
    utm.from_latlon(10.0, -179.9999)[2], refused is not None, round((northing_m[1] - northing_m[0]) / 1e6),
)  # fmt: skip
raise SystemExit(0 if seen == (32, 15, [32, 33], -448, 60, 829, 1, True, 10) else f"no longer so: {seen}")
PYTHON
