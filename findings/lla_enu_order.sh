#!/usr/bin/env bash
# lla-enu is for distances in east, north and up between fixes (degrees and metres). A point 100 m east and 10 m up of a fix is made (`lla_add_enu`), and its distance from it asked for
# (`distance_enu`, said to return east, north, up), 0 m and 3000 m high. Guess: 100, 0, 10 within 0.5 %, as its Earth is a sphere, and the same back at any height, as both are its own.
# Seen with lla-enu 0.1.0 on 2026-12-01, without a word: 0, 100, 10, north first: an axis swap, by which a vehicle heads north for east and turns left for right.
# 3000 m high, it is 99.95 m back: one adds height to the Earth's radius, the other does not. And of a real 100 m east (pyproj) it makes 99.7 m, though 100 m north are right
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3.11 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check numpy==2.4.6 pyproj==3.7.2 2>/dev/null
venv/bin/pip install --quiet --disable-pip-version-check --no-deps lla-enu==0.1.0 2>/dev/null
cat >order.py <<'PYTHON'
import importlib.metadata
import importlib.util
from pathlib import Path

import pyproj

(source,) = [file for file in importlib.metadata.files("lla-enu") if "def distance_enu" in (Path(file.locate()).read_text() if file.suffix == ".py" else "")]
spec = importlib.util.spec_from_file_location("lla_enu_functions", source.locate())
lla_enu = importlib.util.module_from_spec(spec)
spec.loader.exec_module(lla_enu)

LONGITUDE, LATITUDE = 11.5, 48.1
for height_m, back_m in ((0, 100.0), (3000, 99.95)):
    moved = lla_enu.lla_add_enu(LONGITUDE, LATITUDE, height_m, 100, 0, 10)
    found = lla_enu.distance_enu(LONGITUDE, LATITUDE, height_m, *moved).round(2).tolist()
    print(f"{height_m} m high, 100 m east and 10 m up and back: {found}")
    assert found == [0, back_m, 10]
for azimuth, component, seen_m in ((90, 1, 99.7), (0, 0, 100.0)):
    longitude, latitude, _ = pyproj.Geod(ellps="WGS84").fwd(LONGITUDE, LATITUDE, azimuth, 100)
    found = lla_enu.distance_enu(LONGITUDE, LATITUDE, 0, longitude, latitude, 0)
    print(f"100 m to {azimuth} degrees by the ellipsoid: {found.round(2).tolist()}")
    assert round(float(found[component]), 2) == seen_m
PYTHON
venv/bin/python order.py 2>said.txt || { cat said.txt; exit 1; }
test ! -s said.txt
