#!/usr/bin/env bash
# A drone (PX4, .ulg) climbs by 2 m/s, from the ground to 50 m, and turns to the right meanwhile, by 2 degrees a second, from 170 degrees through south to -140. Its
# position (vehicle_local_position, z down) is logged 50 times a second; on a second flight, the same, four times. px4-log-tool makes a metadata.json, by which
# flights are chosen, and a table of ten rows a second (`ulog2csv --merge --resample`), both as its own template of a filter has it.
# Guess: 0 to 50 m; values of the times beside them; headings through south.
# Seen with px4-log-tool 0.6.4 (pandas 2.1.2) on 2026-11-30, without a word:
# - `min_altitude` is 50 and `max_altitude` 0, as z was to be turned round, and its smallest and largest with it
# - each row has the LAST value of the tenth of a second that begins at its time: 0.08 s early, throughout, so that images are joined with what comes after them
# - rows between two of 4 Hz are interpolated by straight lines, headings, too, so that two rows of the turn through south head 60 degrees east and west of north
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3.11 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check px4-log-tool==0.6.4 pandas==2.1.2 numpy==1.26.1 pyulog==1.0.1 "setuptools<80"
cat >flight.py <<'PYTHON'
import struct
from pathlib import Path

import numpy as np


def message(kind, body):
    return struct.pack("<HB", len(body), ord(kind)) + body


def log(hertz):
    """Return a log of the flight; two degrees a second, through south after 5 s."""
    fields = "uint64_t timestamp;float x;float y;float z;float vx;float vy;float vz;float heading;"
    written = b"\x55\x4c\x6f\x67\x01\x12\x35\x01" + struct.pack("<Q", 0)
    written += message("F", f"vehicle_local_position:{fields}".encode())
    written += message("A", struct.pack("<BH", 0, 0) + b"vehicle_local_position")
    for n in range(25 * hertz + 1):
        second = n / hertz
        heading = np.radians((170 + 2 * second + 180) % 360 - 180)
        stamp_us = 10_000_000 + 1_000_000 * n // hertz
        written += message("D", struct.pack("<HQ7f", 0, stamp_us, 0, 0, -2 * second, 0, 0, -2, heading))
    return written


for name, hertz in (("fast", 50), ("slow", 4)):
    Path(name).mkdir()
    Path(name, "flight.ulg").write_bytes(log(hertz))
PYTHON
cat >compare.py <<'PYTHON'
import json

import pandas as pd

(mission,) = json.load(open("fast/metadata.json"))["mission"]
print("metadata:", {name: mission[name] for name in ("min_altitude", "max_altitude", "average_altitude")})
assert (mission["min_altitude"], mission["max_altitude"]) == (50.0, 0.0)
fast, slow = (pd.read_csv(f"{name}.csv", parse_dates=["timestamp"]) for name in ("fast", "slow"))
for table in (fast, slow):
    table["second"] = (table["timestamp"] - pd.Timestamp("1970-01-01 00:00:10")).dt.total_seconds()
early_s = -fast["VehicleLocalPosition_z"] / 2 - fast["second"]
print("rows of the log of 50 Hz are early by", sorted(set(early_s[:-1].round(6))), "s")
assert set(early_s[:-1].round(6)) == {0.08}
degrees = slow["VehicleLocalPosition_heading"] * 57.29578
at_south = degrees[(slow["second"] > 4.4) & (slow["second"] < 5.3)].round(1).tolist()
print("headings of the log of 4 Hz around south:", at_south)
assert any(abs(value) < 91 for value in at_south) and at_south[0] > 178 and at_south[-1] < -178
PYTHON
venv/bin/python flight.py
venv/bin/px4-log-tool generate-filter-template
sed -i 's/- sensor_combined/- vehicle_local_position/; /- actuator_outputs/d' filter.yaml
venv/bin/px4-log-tool generate-metadata -f filter.yaml fast
for name in fast slow; do
  venv/bin/px4-log-tool ulog2csv -m -r -f filter.yaml -o tables_$name $name
  mv unified.csv $name.csv
done
venv/bin/python compare.py
