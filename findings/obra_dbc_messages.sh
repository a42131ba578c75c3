#!/usr/bin/env bash
# The signals of a vehicle's CAN bus (DBC) become messages of ROS 2 with obra-tools: a coolant temperature, 8 bits, -40 degrees and more; a pressure, 8 bits in
# steps of 100 kPa; a fuel rate, 8 bits in steps of 1.5 l/h; and a latitude, 32 bits in steps of 1e-7 degrees. Guess: types that hold the physical values, as
# cantools decodes them; or those of the raw ones, with the step and the offset in the comment.
# Seen with obra-tools 0.1.0 and cantools 45.1.0 on 2026-11-30, without a word: types follow the bits of the raw value and whether the step is
# below 1, ranges in the comments are physical, and steps and offsets are nowhere. Temperature and pressure are uint8, so that no frost fits, and nothing above
# 255 kPa, of 25,500; the fuel rate is uint8, too, and loses its halves; latitude is float32, whose steps are 0.4 m. So a message holds neither the physical
# values nor, for latitude, the raw ones
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check obra-tools==0.1.0 cantools==45.1.0 numpy==2.4.6
cat >vehicle.dbc <<'DBC'
VERSION ""

NS_ :

BS_:

BU_: ECU

BO_ 256 Engine: 8 ECU
 SG_ coolant : 0|8@1+ (1,-40) [-40|215] "degC" Vector__XXX
 SG_ pressure : 8|8@1+ (100,0) [0|25500] "kPa" Vector__XXX
 SG_ fuel_rate : 16|8@1+ (1.5,0) [0|382.5] "l/h" Vector__XXX
 SG_ latitude : 24|32@1- (1E-007,0) [-90|90] "deg" Vector__XXX

DBC
venv/bin/obra-dbc-to-msg vehicle.dbc messages >log.txt
cat messages/Engine.msg
cat >compare.py <<'PYTHON'
import re
from pathlib import Path

import cantools
import numpy as np

PHYSICAL = {"coolant": -10.0, "pressure": 600.0, "fuel_rate": 7.5, "latitude": 48.1234567}
(message,) = cantools.database.load_file("vehicle.dbc").messages
decoded = {name: float(value) for name, value in message.decode(message.encode(PHYSICAL)).items()}
assert all(abs(decoded[name] - value) < 1e-9 for name, value in PHYSICAL.items()), decoded
types = {name: kind for kind, name in re.findall(r"^(\w+) (\w+)$", Path("messages/Engine.msg").read_text(), re.MULTILINE)}
assert types == {"coolant": "uint8", "pressure": "uint8", "fuel_rate": "uint8", "latitude": "float32"}, types
for name, value in decoded.items():
    held = np.array(value).astype(types[name])
    print(f"{name}: {value} in {types[name]} is {held}")
    assert float(held) != value
PYTHON
venv/bin/python -W ignore compare.py
