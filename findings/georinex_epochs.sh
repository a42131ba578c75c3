#!/usr/bin/env bash
# A GNSS receiver has raw observations ten times a second in RINEX 3, and the ephemerides of GPS and GLONASS satellites of the same hour. At which
# times are they in georinex? Guess: at those in the file, on one time scale; with `interval=0.1`, all.
# Seen with georinex 1.16.2 on 2026-11-29:
# - 20.2 s is 20.199999 s: the seconds go through a float and are cut to microseconds, so joins with other tables miss such epochs; the list
#   that `gettime` gives is cut to milliseconds, 20.199 s, and matches neither
# - with `interval=0.1`, 9 of the 10 epochs of a second remain, without a word
# - ephemerides: GPS satellites have GPS time, GLONASS ones UTC, 18 s apart: on one axis, and without a mark of it (observations have one)
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check georinex==1.16.2 xarray==2026.9.0 numpy==2.4.6
cd "$folder"
venv/bin/python -W ignore - <<'PYTHON'
from pathlib import Path

import georinex
import numpy as np

START = np.datetime64("2023-11-14T22:13:20", "ns")


def line(text, label):
    return f"{text:60}{label}\n"


observations = line("     3.04           OBSERVATION DATA    M", "RINEX VERSION / TYPE")
observations += line("  4100000.0000   900000.0000  4800000.0000", "APPROX POSITION XYZ") + line("G    1 C1C", "SYS / # / OBS TYPES")
observations += line("  2023    11    14    22    13   20.0000000     GPS", "TIME OF FIRST OBS") + line("", "END OF HEADER")
for tenth in range(10):
    observations += f"> 2023 11 14 22 13 {20 + tenth / 10:10.7f}  0  1\nG01{20_000_000 + tenth:14.3f}\n"
Path("drive.rnx").write_text(observations)
empty = f"{0:19.12E}"
ephemerides = line("     3.04           N: GNSS NAV DATA    M: MIXED", "RINEX VERSION / TYPE") + line("", "END OF HEADER")
for satellite, rows in (("G01", 7), ("R02", 3)):
    ephemerides += f"{satellite} 2023 11 14 22 00 00{empty * 3}\n" + f"    {empty * 4}\n" * rows
Path("drive.nav").write_text(ephemerides)

orbits, drive = georinex.load("drive.nav"), georinex.load("drive.rnx")
times = drive.time.values.astype("datetime64[ns]")
off_us = (times - START - np.arange(10) * np.timedelta64(100, "ms")).astype(int) // 1000
listed = np.array(georinex.gettime("drive.rnx"), "datetime64[ns]")
thinned = georinex.load("drive.rnx", interval=0.1)
print(f"off by {off_us} us; listed {str(listed[2])[11:]}; {thinned.time.size} of 10 epochs with interval=0.1")
assert set(off_us.tolist()) == {0, -1}
assert thinned.time.size < 10 and times.size == 10
print(f"ephemerides of {orbits.sv.values} at {orbits.time.values}, {orbits.attrs}")
assert orbits.sv.values.tolist() == ["G01", "R02"] and orbits.time.size == 1  # of two times, 22:00:00 and 22:00:18 by GPS
assert drive.attrs["time_system"] == "GPS" and "time_system" not in orbits.attrs
PYTHON
