#!/usr/bin/env bash
# Logs of a CAN bus (candump, Vector ASC) beside their definitions (DBC) are opened with Signal Viewer: a speed in steps of 0.01 km/h and a temperature with an
# offset of -40, each with a name for the value "not available"; a steering angle; a gear with names of all its values.
# Guess: km/h, degrees, a gear that has its values; what comes from a second bus apart from the first; times of a relative ASC added up.
# Seen with signalviewer 1.14.0 on 2026-11-30, without a word:
# - a signal that has a name for any of its values has lost its factor and its offset: 50 km/h are 5000 "[km/h]", 20 degrees are 60 "[degC]". One without names is right
# - the same message of can0 and of can1, of another car, is one signal, of both by turns
# - of an ASC with `timestamps relative` all samples are at 0 s
# - a table of signals (`table`, `to_dataframe`) draws straight lines between gears, too: from P (0) to D (3) by R (1) and N (2)
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check numpy==2.4.6 2>/dev/null
venv/bin/pip install --quiet --disable-pip-version-check --no-deps signalviewer==1.14.0 pandas==3.1.1 python-dateutil==2.9.0.post0 six==1.17.0 2>/dev/null
cat > bus.dbc <<'DBC'
VERSION ""
NS_ :
BS_:
BU_: ECU
BO_ 256 Motion: 8 ECU
 SG_ Speed : 0|16@1+ (0.01,0) [0|655.33] "km/h" ECU
 SG_ Temperature : 16|8@1+ (1,-40) [-40|210] "degC" ECU
 SG_ Angle : 32|16@1- (0.1,0) [-720|720] "deg" ECU
BO_ 512 Gearbox: 1 ECU
 SG_ Gear : 0|4@1+ (1,0) [0|3] "" ECU
VAL_ 256 Speed 65535 "not available" ;
VAL_ 256 Temperature 255 "not available" ;
VAL_ 512 Gear 0 "P" 1 "R" 2 "N" 3 "D" ;
DBC
cat > bus.py <<'PYTHON'
import struct
from pathlib import Path

import numpy as np
import signalviewer


def motion(speed_kmh, temperature_degc, angle_deg):
    return struct.pack("<HBxhH", round(speed_kmh * 100), round(temperature_degc + 40), round(angle_deg * 10), 0).hex().upper()


def candump(*frames):
    Path("drive.log").write_text("".join(f"({1_700_000_000 + time:.6f}) {bus} {frame}\n" for time, bus, frame in frames))
    return signalviewer.load("drive.log")


one = [(time / 10, "can0", "100#" + motion(50, 20, -10)) for time in range(4)]
drive = candump(*one)
found = {name: set(drive.signal(name)[1]) for name in drive.signals}
print("50 km/h, 20 degrees, -10 degrees:", found)
assert found == {"Motion.Speed [km/h]": {5000}, "Motion.Temperature [degC]": {60}, "Motion.Angle [deg]": {-10}}

angles_deg = candump(*one, *((time + 0.05, "can1", "100#" + motion(0, 60, 30)) for time, _, _ in one)).signal("Motion.Angle")[1]
print("angles of can0 (-10) and can1 (30):", angles_deg)
assert angles_deg.tolist() == [-10, 30] * 4

lines = "".join(f"   0.100000 1  100             Rx   d 8 {bytes.fromhex(motion(50, 20, -10)).hex(' ').upper()}\n" for _ in range(4))
Path("relative.asc").write_text("date Thu Jan 15 12:00:00.000 2026\nbase hex  timestamps relative\ninternal events logged\n" + lines)
times_s = signalviewer.load("relative.asc").signal("Motion.Angle")[0]
print("0.1 s after each other, relative:", times_s)
assert times_s.tolist() == [0, 0, 0, 0]

gears = [(0.0, "can0", "200#00"), (0.3, "can0", "200#03")]
_, table = candump(*one, *gears).table(["Motion.Angle [deg]", "Gearbox.Gear"])
print("P, then D:", table["Gearbox.Gear"])
assert np.allclose(table["Gearbox.Gear"], [0, 1, 2, 3], atol=1e-5)
PYTHON
venv/bin/python bus.py 2> said.txt || { tail -5 said.txt; exit 1; }
if grep -i warn said.txt; then exit 1; fi
