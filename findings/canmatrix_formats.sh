#!/usr/bin/env bash
# The definitions of a CAN bus (DBC) are converted with canmatrix, as `canconvert` does, for tools that want another format: a speed as float32,
# a signed temperature, an engine speed in steps of 0.125, a slope in steps of 0.01, and two signals that share bytes and are told apart by a
# page number (multiplexed). What do frames decode to by the converted definitions, with canmatrix itself?
# Guess: to the same, or there is an error where a format lacks something.
# Seen with canmatrix 1.3.3 on 2026-11-29, as it is set up, without a word:
#   KCD     the same
#   SYM     the float is an integer: 12.5 m/s are 1,095,237,632
#   JSON, YAML   signals of all pages at once, each from the other's bytes
#   ARXML   factors have ONE decimal: 1250 rpm are 1000, and 0.01 becomes 0, then 1, so that 1 % is 100 %; signs are gone: -45.0 degrees
#           are 83.0; pages as in JSON
# DBC itself, read and written again, is the same.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check canmatrix==1.3.3 lxml==6.1.3 PyYAML==6.0.4
cd "$folder"
cat >bus.dbc <<'DBC'
VERSION ""
NS_ :
BS_:
BU_: ECU
BO_ 100 Motion: 8 ECU
 SG_ Speed : 0|32@1- (1,0) [0|0] "m/s" ECU
 SG_ Temperature : 39|8@0- (0.5,-40) [0|0] "C" ECU
 SG_ Engine : 40|16@1+ (0.125,0) [0|0] "rpm" ECU
 SG_ Slope : 56|8@1+ (0.01,0) [0|0] "%" ECU
BO_ 300 Pages: 8 ECU
 SG_ Page M : 0|8@1+ (1,0) [0|0] "" ECU
 SG_ Roll m0 : 8|16@1- (0.1,0) [0|0] "" ECU
 SG_ Pressure m1 : 8|16@1+ (0.1,0) [0|0] "" ECU
SIG_VALTYPE_ 100 Speed : 1;
DBC
venv/bin/python -W ignore - <<'PYTHON'
import struct

import canmatrix.formats
from canmatrix import ArbitrationId

FRAMES = {100: struct.pack("<fbHB", 12.5, -10, 10000, 100), 300: struct.pack("<Bh5x", 0, -1)}


def decoded(path):
    """Return the values of both frames by the definitions in that file."""
    bus = canmatrix.formats.loadp_flat(path)
    found = {}
    for number, data in FRAMES.items():
        values = bus.decode(ArbitrationId(number, extended=False), data)
        found |= {name: float(value.phys_value) for name, value in values.items()}
    return found


motion = {"Speed": 12.5, "Temperature": -45.0, "Engine": 1250.0, "Slope": 1.0}
right = motion | {"Page": 0.0, "Roll": -0.1}
both = right | {"Pressure": 6553.5}
seen = {"dbc": right, "kcd": right, "json": both, "yaml": both}
seen["sym"] = motion | {"Speed": 1095237632.0, "Pages_MUX": 0.0, "Roll": -0.1}
seen["arxml"] = both | {"Temperature": 83.0, "Engine": 1000.0, "Slope": 100.0, "Roll": 6553.5}
assert decoded("bus.dbc") == right
for ending, values in seen.items():
    canmatrix.formats.dumpp({"": canmatrix.formats.loadp_flat("bus.dbc")}, f"out.{ending}")
    found = decoded(f"out.{ending}")
    print(f"{ending}: {found}")
    assert found == values, values
PYTHON
