#!/usr/bin/env bash
# Frames of a vehicle's CAN bus are decoded in a web page, with candied of npm, and in Python, with cantools, by the same DBC: speed and acceleration in
# Motorola's byte order (@0), an angle in Intel's (@1), a latitude that is a float (SIG_VALTYPE_), and two signals of which a multiplexer has one at a time.
# Guess: the same numbers, or an error where candied cannot. Seen with candied 2.2.0 of npm and cantools 45.1.0 on 2026-11-30, without a word:
# - the angle: as in cantools. In Motorola's order, speed of 123.45 km/h is null, and -20 m/s2 are 6.5
# - the latitude of 48.125 degrees is 90: its bits are taken for an integer, 1111523328, and what is outside the range that the DBC names is set to the end of
#   it, as is an angle of 203.3 degrees, to 200; cantools has 203.3
# - of the two multiplexed signals both are there in each frame, one of them made of the other's bits
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check cantools==45.1.0
npm install --silent --no-fund --no-audit candied@2.2.0 >/dev/null
cat > vehicle.dbc <<'DBC'
VERSION ""

NS_ :

BS_:

BU_: ECU

BO_ 256 Motion: 8 ECU
 SG_ Speed : 7|16@0+ (0.01,0) [0|655.35] "km/h" ECU
 SG_ Acceleration : 23|12@0- (0.1,-5) [-209.8|199.7] "m/s2" ECU
 SG_ Angle : 40|12@1- (0.1,0) [-200|200] "deg" ECU

BO_ 257 Place: 4 ECU
 SG_ Latitude : 0|32@1- (1,0) [-90|90] "deg" ECU

BO_ 258 Tyres: 3 ECU
 SG_ Wheel M : 0|8@1+ (1,0) [0|1] "" ECU
 SG_ Pressure m0 : 8|16@1+ (1,0) [0|65535] "Pa" ECU
 SG_ Temperature m1 : 8|16@1- (0.5,0) [-16384|16383.5] "degC" ECU

SIG_VALTYPE_ 257 Latitude : 1;
DBC
cat > decode.cjs <<'JS'
const { Can, Dbc } = require("candied");
const { readFileSync } = require("fs");
const can = new Can();
can.database = new Dbc().load(readFileSync("vehicle.dbc", "utf8"));
const decoded = JSON.parse(readFileSync("frames.json")).map(([id, bytes]) => {
  const message = can.decode(can.createFrame(id, bytes));
  return Object.fromEntries([...message.boundSignals].map(([name, signal]) => [name, signal.value]));
});
console.log(JSON.stringify(decoded));
JS
cat > compare.py <<'PYTHON'
import json
import subprocess

import cantools

database = cantools.database.load_file("vehicle.dbc")
sent = [
    ("Motion", {"Speed": 123.45, "Acceleration": -20.0, "Angle": -12.3}),
    ("Motion", {"Speed": 0.0, "Acceleration": -5.0, "Angle": 203.3}),
    ("Place", {"Latitude": 48.125}),
    ("Tyres", {"Wheel": 0, "Pressure": 7}),
    ("Tyres", {"Wheel": 1, "Temperature": -3.5}),
]
frames, in_python = [], []
for name, values in sent:
    message = database.get_message_by_name(name)
    frames.append([message.frame_id, list(message.encode(values, strict=False))])
    in_python.append({signal: round(value, 6) for signal, value in database.decode_message(message.frame_id, bytes(frames[-1][1])).items()})
with open("frames.json", "w") as file:
    json.dump(frames, file)
run = subprocess.run(["node", "decode.cjs"], check=True, capture_output=True, text=True)
in_javascript = json.loads(run.stdout)
for python, javascript in zip(in_python, in_javascript, strict=True):
    print(python, javascript)
assert not run.stderr
assert in_python == [values for _, values in sent]
assert in_javascript == [
    {"Speed": None, "Acceleration": 6.5, "Angle": -12.3},
    {"Speed": None, "Acceleration": -5, "Angle": 200},
    {"Latitude": 90},
    {"Wheel": 0, "Pressure": 7, "Temperature": 3.5},
    {"Wheel": 1, "Pressure": 65529, "Temperature": -3.5},
]
PYTHON
venv/bin/python compare.py
