#!/usr/bin/env bash
# Observations of a receiver of a vehicle, twice a second, in RINEX 3.04, whose times are in GPS time, as its header says: the first one is 2026-01-15 00:00:00 GPS, 23:59:42 UTC. They are read with three
# libraries, to be joined with the rest of the drive by time. Guess: 00:00:00 without a time zone, or 23:59:42 in UTC.
# Seen on 2026-11-30: georinex 1.16.2, 00:00:00 without a zone; pygnss-tec 0.4.2, 23:59:42 UTC; pytecgg 1.4.0, 00:00:00 UTC, without a word: `epoch` is `datetime[μs, UTC]`, 18 s too late. A join
# "as of" with poses in UTC finds one of each, 180 m away at 10 m/s; a table of both libraries has each observation twice, 18 s apart
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check georinex==1.16.2 pygnss-tec==0.4.2 pytecgg==1.4.0 numpy==2.4.6 polars==2.1.0 2>/dev/null
cat > epochs.py <<'PYTHON'
from datetime import UTC, datetime, timedelta
from importlib.metadata import version

import georinex
import gnss_tec
import polars as pl
import pytecgg.parsing

START = datetime(2026, 1, 15)
HEADER = (
    ("     3.04           OBSERVATION DATA    M", "RINEX VERSION / TYPE"),
    ("maker               nobody              20260115 000000 UTC", "PGM / RUN BY / DATE"),
    ("CAR1", "MARKER NAME"),
    ("", "OBSERVER / AGENCY"),
    ("1                   RECEIVER            1", "REC # / TYPE / VERS"),
    ("1                   ANTENNA", "ANT # / TYPE"),
    ("  4075580.0000   931854.0000  4801568.0000", "APPROX POSITION XYZ"),
    ("        0.0000        0.0000        0.0000", "ANTENNA: DELTA H/E/N"),
    ("G    2 C1C L1C", "SYS / # / OBS TYPES"),
    ("     0.500", "INTERVAL"),
    ("  2026     1    15     0     0    0.0000000     GPS", "TIME OF FIRST OBS"),
    ("", "END OF HEADER"),
)
with open("car.rnx", "w") as file:
    file.writelines(f"{values:<60}{label}\n" for values, label in HEADER)
    for number in range(6):
        time = START + timedelta(seconds=number / 2)
        file.write(f"> {time:%Y %m %d %H %M}{time.second + time.microsecond / 1e6:11.7f}  0  1\nG01{20e6 + number:14.3f}  {105e6 + number:14.3f}  \n")

by_georinex = georinex.load("car.rnx").time.values[0].astype("datetime64[s]").item()
_, observations = gnss_tec.read_rinex_obs("car.rnx")
by_gnss_tec = observations.lazy().collect()["time"][0]
table, *_ = pytecgg.parsing.read_rinex_obs("car.rnx")
by_pytecgg = table["epoch"][0]
print("georinex", version("georinex"), by_georinex)
print("pygnss-tec", version("pygnss-tec"), by_gnss_tec)
print("pytecgg", version("pytecgg"), by_pytecgg, table.schema["epoch"])
assert by_georinex == START
assert by_gnss_tec == START.replace(tzinfo=UTC) - timedelta(seconds=18)
assert by_pytecgg == START.replace(tzinfo=UTC) and table.schema["epoch"] == pl.Datetime("us", "UTC")

seconds = [START.replace(tzinfo=UTC) - timedelta(seconds=18 - number) for number in range(60)]
poses = pl.DataFrame({"epoch": pl.Series(seconds).cast(pl.Datetime("us", "UTC")), "x_m": [10.0 * number for number in range(60)]})
joined = table.sort("epoch").join_asof(poses.sort("epoch"), on="epoch")
print("x of the first observation:", joined["x_m"][0], "m, and 0 is right")
assert joined["x_m"][0] == 180
PYTHON
venv/bin/python epochs.py > said.txt 2>&1 || { tail -5 said.txt; exit 1; }
if grep -i "utc" said.txt | grep -i warn; then exit 1; fi
cat said.txt
