#!/usr/bin/env bash
# A temperature on a CAN bus has a name for one raw value, 255 "SNA" (signal not available). What are the decoded values?
# Guess: numbers, or the raw number beside the name. Seen with cantools 45.1.0 on 2026-11-28: -40.0 for raw 0, and for 255 a
# NamedSignalValue, whose `value` is the raw 255 while the number beside it is scaled. It equals its name and no number, neither the raw
# nor the scaled one; float() of it is a TypeError, a gear cannot be sorted, and an array of the column has dtype object.
# Without names (`decode_choices=False`) "not available" is 87.5 degrees, a number like any other. Both lose silently what the other tells.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check cantools==45.1.0 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import cantools
import numpy as np

DBC = """VERSION ""
BU_: ECU
BO_ 258 Engine: 2 ECU
 SG_ temperature : 8|8@1+ (0.5,-40) [-40|87.5] "C" ECU
 SG_ gear : 0|3@1+ (1,0) [0|7] "" ECU
VAL_ 258 temperature 255 "SNA" ;
VAL_ 258 gear 0 "P" 1 "R" ;
"""
message = cantools.database.load_string(DBC, "dbc").get_message_by_name("Engine")
cold, lost = (message.decode(bytes([1, raw])) for raw in (0, 255))
gear, temperature = lost["gear"], lost["temperature"]


def fails(function):
    try:
        function()
    except TypeError as error:
        print("TypeError:", error)
        return True
    return False


seen = (
    cold["temperature"], temperature.value, temperature == "SNA", temperature == 255, temperature == 87.5, gear == 1,
    fails(lambda: float(temperature)), fails(lambda: sorted([gear, cold["gear"]])),
    np.array([cold["temperature"], temperature]).dtype == object,
    message.decode(bytes([1, 255]), decode_choices=False)["temperature"],
)  # fmt: skip
print(seen)
expected = (-40.0, 255, True, False, False, False, True, True, True, 87.5)
raise SystemExit(0 if seen == expected else "no longer so")
PYTHON
