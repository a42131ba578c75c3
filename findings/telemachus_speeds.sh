#!/usr/bin/env bash
# Two cars of the AEGIS dataset (Graz; acceleration 24 times a second, GPS 5 times) drive at the same time: one north at 20 m/s, the other one, 2 km to the west, stands. Their CSVs
# become a table with telemachus, whose adapter for AEGIS has `speed_mps` of positions. Guess: 20 m/s in each row of one trip and 0 in those of the other, up to the rounding of positions.
# Seen with telemachus 0.9.0 on 2026-11-30, for each car alone, without a word: 0 in four of five rows, and 80, the most there may be, in the others: each row has the nearest fix, so a
# way of 0.2 s is driven in one row's 1/24 s, at 96 m/s, which is cut. Their mean is 17. And both at once, as `load` takes the five longest trips: rows of one trip have
# fixes of the other car, as only times are looked at; so the one that stands is where the other drives in half of its rows
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check telemachus==0.9.0 pandas==2.3.3 pyarrow==26.0.1 numpy==2.4.6
venv/bin/python - <<'PYTHON'
from pathlib import Path

import numpy as np
import pandas as pd
from telemachus.adapters.aegis import load

SECONDS, NORTH_DEG, EAST_DEG, METRES_PER_DEG = 60, 47.07, 15.44, 111_195.0  # of latitude, on the sphere that the adapter has


def nmea(degrees):
    """Return degrees as AEGIS has them: degrees times 100, plus minutes."""
    return np.floor(degrees) * 100 + degrees % 1 * 60


def write(cars):
    """Write the trips of these cars: speed, and how far the place lies to the west."""
    start = pd.Timestamp("2016-05-01 12:00:00")
    shaken, fixes = [], []
    for trip, (speed_mps, west_m) in cars.items():
        times_s = np.arange(0, SECONDS, 1 / 24)
        shaken.append(pd.DataFrame({"trip_id": trip, "timestamp": start + pd.to_timedelta(times_s, "s"), "x_value": 0.0, "y_value": 0.0, "z_value": 1.0}))
        times_s = np.arange(0, SECONDS, 0.2) + 0.001 * trip
        north_deg = NORTH_DEG + speed_mps * times_s / METRES_PER_DEG
        east_deg = np.full(len(times_s), EAST_DEG - west_m / METRES_PER_DEG / np.cos(np.radians(NORTH_DEG)))
        at = start + pd.to_timedelta(times_s, "s")
        fixes.append(pd.DataFrame({"trip_id": trip, "timestamp": at, "latitude": nmea(north_deg), "longitude": nmea(east_deg), "altitude": 350.0}))
    pd.concat(shaken).to_csv("accelerations.csv", index=False)
    pd.concat(fixes).to_csv("positions.csv", index=False)
    pd.DataFrame({"trip_id": list(cars), "beaglebone_id": list(cars)}).to_csv("trips.csv", index=False)


for speed_mps in (20, 0):
    write({1: (speed_mps, 0)})
    speeds = load(Path("."), with_gyro=False)["speed_mps"].dropna()
    print(f"{speed_mps} m/s: {(speeds < 0.1).mean():.0%} of rows at 0, {(speeds == 80).mean():.0%} at 80, mean {speeds.mean():.1f}")
    assert np.isclose([(speeds < 0.1).mean(), (speeds == 80).mean(), speeds.mean()], [0.79, 0.21, 16.6] if speed_mps else [1, 0, 0], atol=0.01 * max(1, speed_mps)).all()

write({1: (20, 0), 2: (0, 2000)})
table = load(Path("."), with_gyro=False)
standing = table[table["trip_id"] == "2"]
elsewhere = (standing["lon"] - EAST_DEG).abs() < 0.01
print(f"the car that stands: {len(standing)} rows, {elsewhere.mean():.0%} of them where the other one drives")
assert 0.45 < elsewhere.mean() < 0.55
PYTHON
