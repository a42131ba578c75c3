#!/usr/bin/env bash
# An Xsens MTi-8 sends 20,000 messages (MTData2) with a counter, accelerations and an orientation, whose output can be set to float32, fixed point (fp12.20) or float64, with axes east, north, up
# or north, east, down. mti8-navigation reads them, as it does from the port. Guess: all of them, with the same numbers, or an error for a format that it does not know.
# Seen with mti8-navigation 1.0.0 on 2026-11-30, without a word:
# - it takes less than one in 100: a checksum is right if the bytes ADD up to 0 (FA FF 30 00 D1 is "go to config" in the manual of Xsens), as its own sniffer has it, and its reader wants 0 of
#   their XOR. The rest is passed over as noise, so that the sensor looks like one of 0.7 Hz
# - a fixed-point orientation is read as float32: NaN for any turn to the right, since only the length of a field is looked at. In any format but float32 there is no acceleration
# - axes north, east, down are taken for east, north, up: one orientation is a yaw of 45 degrees either way
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check platformdirs==4.14.9 tomli-w==1.2.0 numpy==2.4.6
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check --no-deps mti8-navigation==1.0.0  # what it needs besides are windows
cd "$folder"
HOME=$folder venv/bin/python - <<'PYTHON'
import math
import random
import struct
from functools import reduce
from operator import xor

from mti8_navigation.xsens.xbus_parser import XbusParser, checksum_ok

TURN = (math.cos(math.pi / 8), 0.0, 0.0, math.sin(math.pi / 8))  # 45 degrees to the left
PULL = (0.1, 0.2, 9.81)


def message(counter, *fields):
    data = struct.pack(">HBH", 0x1020, 2, counter) + b"".join(struct.pack(">HB", kind, len(field)) + field for kind, field in fields)
    body = bytes([0xFF, 0x36, len(data)]) + data
    return b"\xfa" + body + bytes([-sum(body) & 0xFF])


def floats(*values):
    return struct.pack(f">{len(values)}f", *values)


def fixed(*values):
    return struct.pack(f">{len(values)}i", *(round(value * 2**20) for value in values))


assert not checksum_ok(bytes.fromhex("faff3000d1"))  # as the manual has it
random.seed(0)
read = 0
for number in range(20_000):
    shaken = floats(*(value + random.gauss(0, 0.1) for value in PULL))
    sent = message(number, (0x4020, shaken), (0x2010, floats(*TURN)))
    state = XbusParser().parse_buffer(bytearray(sent))
    assert (state is not None) == (reduce(xor, sent[1:]) == 0)
    read += state is not None
print(f"{read} of 20000 messages are read")
assert 0 < read < 200


def state_of(*fields):
    """Return what is read of a message with a counter that lets it pass."""
    states = (XbusParser().parse_buffer(bytearray(message(counter, *fields))) for counter in range(65_536))
    return next(state for state in states if state is not None)


right = (TURN[0], 0.0, 0.0, -TURN[3])
for name, kind, data in (
    ("float32", 0x2010, floats(*TURN)),
    ("float32, north, east, down", 0x2014, floats(*TURN)),
    ("fixed", 0x2011, fixed(*TURN)),
    ("fixed, to the right", 0x2011, fixed(*right)),
):
    yaw = state_of((kind, data)).yaw
    print(f"{name}: yaw {yaw:.2f}")
    assert math.isnan(yaw) if "right" in name else abs(yaw - 45) < 0.01
found = [state_of((kind, data)).acceleration for kind, data in ((0x4020, floats(*PULL)), (0x4021, fixed(*PULL)), (0x4023, struct.pack(">3d", *PULL)))]
print("accelerations:", *found)
assert found[0] is not None and found[1:] == [None, None]
PYTHON
