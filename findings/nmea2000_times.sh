#!/usr/bin/env bash
# A boat's NMEA 2000 bus was recorded as text by a gateway (Yacht Devices' RAW: "23:59:59.900 R 0DF01001 …", a time of day in each line). The
# message System Time says 14 Nov 2023, 12:00:00.5. Which times does the nmea2000 package give?
# Guess: the time of day of the line, on a day that one has to name; and half a second past twelve.
# Seen with nmea2000 2026.10.3 on 2026-11-29, without a word:
# - `timestamp` is the time of day on the day of READING, and over midnight it goes back by a day: the line 0.2 s later is 86,399.8 s earlier
# - the field `time` is 12:00:00: the system has 0.1 ms, its `value` whole seconds. Only `raw_value` has them, 43200.5
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check nmea2000==2026.10.3
cd "$folder"
venv/bin/python - <<'PYTHON'
import struct
from datetime import date, datetime, time, timedelta

from nmea2000.decoder import NMEA2000Decoder

DAY, NOON_AND_A_HALF = 19675, 432_005_000  # since 1970; in 0.1 ms
GPS_TIME = struct.pack("<BBHI", 1, 0xF0, DAY, NOON_AND_A_HALF).hex(" ").upper()

decoder = NMEA2000Decoder()
today = datetime.now().date()
before, after = (decoder.decode(f"{clock} R 0DF01001 {GPS_TIME}") for clock in ("23:59:59.900", "00:00:00.100"))
fields = {field.id: field for field in before.fields}
print(before.timestamp, after.timestamp, fields["date"].value, fields["time"].value, fields["time"].raw_value)
assert before.PGN == 126992
assert today <= before.timestamp.date() <= datetime.now().date()
assert after.timestamp - before.timestamp == timedelta(seconds=0.2) - timedelta(days=1)
assert (fields["date"].value, fields["time"].value) == (date(2023, 11, 14), time(12, 0, 0))
assert fields["time"].raw_value == 43200.5
PYTHON
