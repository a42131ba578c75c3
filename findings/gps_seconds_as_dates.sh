#!/usr/bin/env bash
# A receiver's GPS time, 1,384,035,218 s since 1980, which is 22:13:20 UTC on 14 November 2023, becomes a date; and a recording of
# 31 December 2016, a day with a leap second at its end, has Unix times. Which dates do libraries of time give?
# Guess: UTC, as everything else does that prints a date; and Unix time 12:00:00 is noon on any day.
# Seen with astropy 8.0.2 and hifitime 4.3.1 on 2026-11-29:
# - astropy, `Time(…, format="gps")`: `iso`, `datetime` and `datetime64` say 22:13:57, which is TAI, without a mark of it; `.utc` is needed in
#   between. hifitime says 22:13:38 GPST, and names the scale
# - astropy, `format="unix"` on 31 December 2016: the day is stretched over its 86,401 s, so that noon is 12:00:00.5, and 23:59:59.5 is half a
#   second into the leap second. On all other days it is exact. hifitime has noon; 23:59:60 itself is 23:59:59 to it, as to Unix
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check astropy==8.0.2 hifitime==4.3.1
cd "$folder"
venv/bin/python - <<'PYTHON'
from astropy.time import Time
from hifitime import Epoch

GPS_S, NOON_S = 1_384_035_218, 1_483_185_600  # 2023-11-14T22:13:20 and 2016-12-31T12:00:00 in UTC

gps = Time(GPS_S, format="gps")
print(f"astropy: {gps.iso}, {gps.datetime}, {gps.datetime64}, with .utc {gps.utc.iso}; hifitime: {Epoch.from_gpst_seconds(GPS_S)}")
assert gps.iso == "2023-11-14 22:13:57.000" and gps.datetime.second == 57 and str(gps.datetime64)[17:19] == "57"
assert gps.utc.iso == "2023-11-14 22:13:20.000" and gps.unix == 1_700_000_000
assert str(Epoch.from_gpst_seconds(GPS_S)) == "2023-11-14T22:13:38 GPST"

for unix_s, by_astropy, by_hifitime in (
    (NOON_S - 86400, "2016-12-30T12:00:00.000", "2016-12-30T12:00:00 UTC"),
    (NOON_S, "2016-12-31T12:00:00.500", "2016-12-31T12:00:00 UTC"),
    (NOON_S + 43199.5, "2016-12-31T23:59:60.500", "2016-12-31T23:59:59.500000000 UTC"),
):
    seen = Time(unix_s, format="unix").utc.isot, str(Epoch.from_unix_seconds(unix_s))
    print(f"Unix time {unix_s}: astropy {seen[0]}, hifitime {seen[1]}")
    assert seen == (by_astropy, by_hifitime)
assert str(Epoch("2016-12-31T23:59:60 UTC")) == "2016-12-31T23:59:59 UTC"
PYTHON
