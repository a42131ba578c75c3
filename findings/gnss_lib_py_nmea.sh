#!/usr/bin/env bash
# A car stands for 3 s near Munich, then drives east at 10 m/s, 19.44 knots, 560 m above the sea; the geoid is 46 m above the ellipsoid there. Its receiver's
# sentences, GGA and RMC, once a second, are read with gnss_lib_py, whose rows have units in their names. While it stands RMC has no course, as receivers
# leave it out. Guess: `vx_rx_mps` of 10, `alt_rx_m` of 606 or 560, x, y, z of the ellipsoid (606), no heading while it stands. Seen with gnss-lib-py 1.1.0
# and pynmea2 1.19.0 on 2026-11-30, without a word:
# - `vx_rx_mps` is 19.44: it is knots
# - `alt_rx_m` is above the sea, and x, y, z are made of it as if it were above the ellipsoid: 46 m below the car
# - while it stands it heads east, as it does later: a missing course is that of the FUTURE, which no node has at that time
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check gnss-lib-py==1.1.0 pynmea2==1.19.0 pymap3d==3.2.0 numpy==2.4.6 pandas==2.3.3
cat > read.py <<'PYTHON'
from functools import reduce

import numpy as np
import pymap3d
from gnss_lib_py.parsers.nmea import Nmea

SEA_M, GEOID_M, KNOTS = 560.0, 46.0, 10 / 0.514444


def sentence(body):
    return f"${body}*{reduce(lambda total, char: total ^ ord(char), body, 0):02X}\n"


with open("drive.nmea", "w") as file:
    for second in range(6):
        at, east_min = f"1200{second:02d}.00", max(0, second - 2) * 10 / 1241.8
        place = f"4808.00000,N,011{30 + east_min:08.5f},E"
        file.write(sentence(f"GNGGA,{at},{place},4,20,0.6,{SEA_M:.1f},M,{GEOID_M:.1f},M,,"))
        motion = f"{KNOTS:.2f},90.0" if second > 2 else "0.00,"
        file.write(sentence(f"GNRMC,{at},A,{place},{motion},150126,,,R"))

drive = Nmea("drive.nmea", include_ecef=True)
speeds, headings = drive["vx_rx_mps"].tolist(), np.degrees(drive["heading_rx_rad"]).round(1).tolist()
latitude, longitude, height_m = pymap3d.ecef2geodetic(*(drive[f"{axis}_rx_m"] for axis in "xyz"))
print(f"{speeds} as m/s, {headings} degrees, {drive['alt_rx_m'].tolist()} m, {height_m.round(2).tolist()} m above the ellipsoid, {drive['geo_sep'].tolist()}")
assert speeds == [0, 0, 0] + [19.44] * 3
assert headings == [90] * 6
assert drive["alt_rx_m"].tolist() == [SEA_M] * 6
assert np.allclose(height_m, SEA_M, atol=0.01)
PYTHON
venv/bin/python read.py 2> said.txt
if grep -iE 'knot|geoid|ellipsoid|course' said.txt; then exit 1; fi
