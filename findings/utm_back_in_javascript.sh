#!/usr/bin/env bash
# Fixes of a drive are turned into UTM and back, in a web page (utm of npm) and in Python (utm), whose code is the same, as the former was made of the latter.
# How far from a fix is what comes back? Guess: less than a millimetre, as in Python. Seen with utm 1.1.1 of npm and utm 0.9.0 in Python on 2026-11-30,
# without a word: Python, below a millimetre. npm: in the middle of a zone, too, but at its border 0.5 m east or west in Mumbai (19 degrees north), 0.3 m in
# Cape Town, 0.1 m in Munich, away from the middle. The way there is right in both to a millimetre, so that the error is in `toLatLon`; a strict range of
# eastings does not show it
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check utm==0.9.0 numpy==2.4.6
npm install --silent --no-fund --no-audit utm@1.1.1 >/dev/null
cat > back.cjs <<'JS'
const utm = require("utm");
const places = JSON.parse(require("fs").readFileSync("places.json"));
const found = places.map(([latitude, longitude]) => {
  const grid = utm.fromLatLon(latitude, longitude, 32);
  const back = utm.toLatLon(grid.easting, grid.northing, grid.zoneNum, grid.zoneLetter);
  return [grid.easting, grid.northing, back.latitude, back.longitude];
});
console.log(JSON.stringify(found));
JS
cat > compare.py <<'PYTHON'
import json
import subprocess

import numpy as np
import utm

MIDDLE, DEGREE_M = 9.0, 111_320
LATITUDES = {"Mumbai": 19.0, "Cape Town": -33.9, "Munich": 48.1}
EXPECTED_M = {"Mumbai": 0.5, "Cape Town": 0.3, "Munich": 0.1}
places = [(latitude, MIDDLE + off) for latitude in LATITUDES.values() for off in (-2.9, 0.0, 2.9)]
with open("places.json", "w") as file:
    json.dump(places, file)
in_javascript = json.loads(subprocess.run(["node", "back.cjs"], check=True, capture_output=True, text=True).stdout)
in_python = []
for place in places:
    easting, northing, zone, letter = utm.from_latlon(*place, 32)
    in_python.append([easting, northing, *utm.to_latlon(easting, northing, zone, letter)])


def off_m(found):
    """Return how far north and east each is from its place, after the way there and back."""
    degrees = np.array(found)[:, 2:] - places
    return degrees * DEGREE_M * np.column_stack([np.ones(len(places)), np.cos(np.radians([latitude for latitude, _ in places]))])


assert np.allclose(np.array(in_javascript)[:, :2], np.array(in_python)[:, :2], atol=1e-3)
assert np.abs(off_m(in_python)).max() < 1e-3
for name, east_m in zip(LATITUDES, off_m(in_javascript)[:, 1].reshape(-1, 3), strict=True):
    print(f"{name}: {east_m.round(3).tolist()} m to the east, 2.9 degrees west of the middle, there, and east of it")
    assert np.allclose(east_m, [-EXPECTED_M[name], 0, EXPECTED_M[name]], atol=0.05)
PYTHON
venv/bin/python compare.py
