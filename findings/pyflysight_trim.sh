#!/usr/bin/env bash
# A FlySight 2 records a flight to the east at 47 degrees north: humidity at 1 Hz and pressure at 50 Hz by a clock of its own (SENSOR.CSV), positions at 5 Hz (TRACK.CSV).
# pyflysight reads both, cuts seconds 12.5 to 20.5 (`trim_log`), and moves the track to (0, 0), as it does to hide where one has flown (`normalize_gps`).
# Guess: what was at one instant is at one instant of the cut; a track as long as before.
# Seen with pyflysight 0.10.0 on 2026-11-30, without a word:
# - each sensor, and the track, begins at 0 s of its own: humidity of 12.9 s beside pressure of 12.5 s, 0.4 s apart; `time` of the sensors tells it, but the track's is
#   of another clock. The last sample of the window is not in it, and humidity ends with that of 19.9 s
# - moved to the equator the track is 1.47 times as long, 150 m for 102 m, as degrees of longitude are added up and are longer there; its speeds stay
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check pyflysight==0.10.0 polars==2.1.0 2>/dev/null
cat > flight.py <<'PYTHON'
from datetime import UTC, datetime, timedelta
from math import cos, radians
from pathlib import Path

from pyflysight.flysight_proc import parse_v2_log_directory

HEAD = "$FLYS,1\n$VAR,FIRMWARE_VER,v2024.05.25\n$VAR,DEVICE_ID,0001\n$VAR,SESSION_ID,0002\n"
EAST_M_S, LATITUDE_DEG, STARTED_S = 5.0, 47.0, 1000.0
METRES_A_DEGREE = 111_195.0

rows = [(0.0, "$TIME,{:.3f},316515.000,2311")]
rows += [(0.9 + second, "$HUM,{:.3f},%.1f,20.0" % (40 + second)) for second in range(30)]
rows += [(tick / 50, "$BARO,{:.3f},%.2f,20.0" % (100_000 - tick)) for tick in range(1, 1500)]
sensors = "$COL,BARO,time,pressure,temperature\n$UNIT,BARO,s,Pa,deg C\n$COL,HUM,time,humidity,temperature\n$UNIT,HUM,s,percent,deg C\n"
sensors += "$COL,TIME,time,tow,week\n$UNIT,TIME,s,s,\n"
Path("SENSOR.CSV").write_text(HEAD + sensors + "$DATA\n" + "".join(line.format(STARTED_S + time) + "\n" for time, line in sorted(rows)))

begin = datetime(1980, 1, 6, tzinfo=UTC) + timedelta(weeks=2311, seconds=316_515)
columns = "$COL,GNSS,time,lat,lon,hMSL,velN,velE,velD,hAcc,vAcc,sAcc,numSV\n$UNIT,GNSS,,deg,deg,m,m/s,m/s,m/s,m,m,m/s,\n"
degrees_a_fifth = EAST_M_S / 5 / (METRES_A_DEGREE * cos(radians(LATITUDE_DEG)))
track = "".join(
    f"$GNSS,{(begin + timedelta(seconds=fifth / 5)).isoformat(timespec='milliseconds')[:23]}Z,{LATITUDE_DEG},{11 + degrees_a_fifth * fifth:.9f},500,0,{EAST_M_S},0,1,1,1,12\n"
    for fifth in range(103)
)
Path("TRACK.CSV").write_text(HEAD + columns + "$DATA\n" + track)


def length_m(positions):
    """Return how long a track to the east is."""
    return (positions["lon"][-1] - positions["lon"][0]) * METRES_A_DEGREE * cos(radians(positions["lat"][0]))


log = parse_v2_log_directory(Path())
log.trim_log(12.5, 20.5)
humidity, pressure = log.sensor_data["HUM"], log.sensor_data["BARO"]
print(humidity.select("time", "elapsed_time", "humidity").head(1).to_dicts(), pressure.select("time", "elapsed_time", "pressure").head(1).to_dicts())
print("the last:", humidity["time"][-1], pressure["time"][-1])
assert humidity["elapsed_time"][0] == pressure["elapsed_time"][0] == log.track_data["elapsed_time_sensor"][0] == 0
assert (humidity["time"][0], pressure["time"][0]) == (1012.9, 1012.5)
assert (humidity["time"][-1], pressure["time"][-1]) == (1019.9, 1020.48)

log = parse_v2_log_directory(Path())
before_m = length_m(log.track_data)
log.normalize_gps()
after_m = length_m(log.track_data)
print(f"the track: {before_m:.1f} m, moved to the equator {after_m:.1f} m, at {log.track_data['groundspeed'][0]} m/s")
assert abs(before_m - 102) < 0.1 and abs(after_m / before_m - 1 / cos(radians(LATITUDE_DEG))) < 1e-6
assert log.track_data["groundspeed"][0] == EAST_M_S
PYTHON
venv/bin/python flight.py 2> said.txt || { tail -5 said.txt; exit 1; }
if grep -i warn said.txt; then exit 1; fi
