#!/usr/bin/env bash
# Fixes of a GNSS receiver, four a second, have GPS time (week and seconds of the week), which gtimes ("high-precision GPS time conversion") turns into UTC and back: the
# one at 252,818 s of week 2288 is of 22:13:20 UTC on 14 November 2023, 1,384,035,218 s since 1980. It runs in Munich, and in Singapore.
# Guess: the same there as here, with the fractions of a second. Seen with gtimes 0.6.0 on 2026-11-30, without a word:
# - the fixes at .5 and .75 s are a second late: 22:13:21.5 and 21.75, as the fraction is added twice and cut off once
# - `UTCFromGps(…, dtimeObj=True)`, "UTC datetime object", has the time of the computer's zone, without its zone: 23:13:20 in Munich
# - `GpsSecondsFromPyUTC` is 18 s less: leap seconds are taken away and added
# - in Singapore, week and seconds are those of half an hour ago, and UTC is half an hour late: 1980, from which it counts, is taken in local time, and the zone
#   of Singapore was another until 1982
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
localedef -i en_US -f UTF-8 ./en_US.UTF-8  # the locale that gtimes asks for
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check gtimes==0.6.0
cat >convert.py <<'PYTHON'
import sys

from gtimes.gpstime import GpsSecondsFromPyUTC, UTCFromGps, gpsFromUTC

WEEK, SECOND, UNIX = 2288, 252_818, 1_700_000_000
assert UNIX - 315_964_800 + 18 == WEEK * 604_800 + SECOND
late_s = 0 if sys.argv[1] == "Munich" else 1800
times = [UTCFromGps(WEEK, SECOND + fraction)[-2:] for fraction in (0.0, 0.25, 0.5, 0.75)]
as_datetime = UTCFromGps(WEEK, SECOND, dtimeObj=True)
there = gpsFromUTC(2023, 11, 14, 22, 13, 20)[:2]
seconds = GpsSecondsFromPyUTC(UNIX)
print(f"{sys.argv[1]}: minutes and seconds {times}, {as_datetime!s} {as_datetime.tzinfo}; week and second {there}; since 1980 {seconds}")
minute = 13 + late_s // 60
assert times == [(minute, 20.0), (minute, 20.25), (minute, 21.5), (minute, 21.75)]
assert str(as_datetime) == ("2023-11-14 23:13:20" if late_s == 0 else "2023-11-15 06:43:20") and as_datetime.tzinfo is None
assert there == (WEEK, SECOND - late_s)
assert seconds == UNIX - 315_964_800 - late_s
PYTHON
export LOCPATH=$folder LANG=en_US.UTF-8
TZ=Europe/Berlin venv/bin/python convert.py Munich
TZ=Asia/Singapore venv/bin/python convert.py Singapore
