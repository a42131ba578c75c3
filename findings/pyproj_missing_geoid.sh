#!/usr/bin/env bash
# What does pyproj make of a height above the ellipsoid, as GNSS gives it, that is to become one above the sea (EPSG:32632+5773)?
# Guess: some 46 m less near Munich, or an error where the grid of the geoid is not installed, as it is in no wheel.
# Seen with pyproj 3.7.2 on 2026-11-28, offline as it is set up: the same height, 500 m for 500 m, without a word. Only the description
# says "ballpark", and the accuracy -1. With `only_best=True` the answer is inf for everything, the easting included.
# Nor is a 2D system 2D: from EPSG:4326, which has no height, to geocentric EPSG:4978 the third number is taken as one.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check pyproj==3.7.2
cd "$folder"
venv/bin/python - <<'PYTHON'
import math

import pyproj
from pyproj import Transformer

pyproj.network.set_network_enabled(active=False)
plain = Transformer.from_crs("EPSG:4979", "EPSG:32632+5773")
height_m = plain.transform(48.0, 11.0, 500.0)[2]
best = Transformer.from_crs("EPSG:4979", "EPSG:32632+5773", only_best=True).transform(48.0, 11.0, 500.0)
print("height:", height_m, "|", plain.description, "| accuracy", plain.accuracy, "| only_best:", best)
flat, solid = (Transformer.from_crs(crs, "EPSG:4978").transform(48.0, 11.0, 500.0) for crs in ("EPSG:4326", "EPSG:4979"))
print("2D:", flat, "3D:", solid)
seen = (height_m, "ballpark" in plain.description.lower(), all(map(math.isinf, best)), flat == solid)
raise SystemExit(0 if seen == (500.0, True, True, True) else f"no longer so: {seen}")
PYTHON
