#!/usr/bin/env bash
# A boat's NMEA 2000 bus was recorded by a gateway: the compass gives 90 degrees magnetic, where north of the compass is 10 degrees to the west (variation); then it has an error, for which
# the standard has a number of its own beside that for "not available": the last but one, 65534. So have the log and the receiver.
# Guess: all say "magnetic", and no heading, speed, depth or position where there was an error. Seen on 2026-11-30, without a word:
#   pylibnmea2k 0.2.4   "degrees true", 90, whether the compass says true or magnetic (80 would be true), and no field for which, nor for the variation; the same for the course. An error is a
#                       heading of 15.5 degrees (65534, as radians, less a turn), 1274 knots, 42,949,673 m deep, at 214.7 degrees north
#   n2k 0.5.0, nmea2k 0.2.0   magnetic, with the variation; an error is a heading of 6.55 rad
#   nmea2000 2026.10.3, @canboat/canboatjs 3.20.0 (npm)   magnetic, with the variation; an error is no heading. All have none for "not available"
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check pylibnmea2k==0.2.4 n2k==0.5.0 nmea2k==0.2.0 nmea2000==2026.10.3 python-can==4.6.1
cd "$folder"
npm install --silent --no-fund --no-audit --prefix "$folder" @canboat/canboatjs@3.20.0 >/dev/null
cat > read.cjs <<'JS'
const { FromPgn } = require("@canboat/canboatjs");
const parser = new FromPgn({});
console.log(JSON.stringify(process.argv.slice(2).map((line) => parser.parseYDGW02(line).fields.heading ?? null)));
JS
venv/bin/python - <<'PYTHON'
import json
import struct
import subprocess

import n2k.messages
from n2k.message import Message
from nmea2000.decoder import NMEA2000Decoder
from nmea2k.gen.pgn_127250 import VesselHeading
from pylibnmea2k import decode

NONE, ERROR = 0xFFFF, 0xFFFE


def line(pgn, data):
    return f"12:00:00.000 R {2 << 26 | pgn << 8 | 1:08X} {data.hex(' ').upper()}"


def heading(raw, magnetic=True):
    return struct.pack("<BHhhB", 1, raw, 0, -1745, 0xFC | magnetic)


def by_nmea2000(data):
    fields = {field.id: field.value for field in NMEA2000Decoder().decode(line(127250, data)).fields}
    return fields["heading"], fields["reference"]


def by_n2k(data):
    found = n2k.messages.parse_n2k_heading(Message(source=1, priority=2, pgn=127250, data=bytearray(data)))
    return found.heading, found.ref.name


def by_nmea2k(data):
    found = VesselHeading()
    found.decode_data(data)
    return found.heading, found.reference.name


right, wrong, none = (heading(raw) for raw in (15708, ERROR, NONE))
east, true_east = decode(line(127250, right)), decode(line(127250, heading(15708, magnetic=False)))
print("pylibnmea2k:", east, decode(line(127250, wrong)))
assert east == true_east and abs(east.hdg_deg - 90) < 0.01 and decode(line(127250, none)) is None
assert abs(decode(line(127250, wrong)).hdg_deg - 15.48) < 0.01
assert decode(line(129026, struct.pack("<BBHHH", 1, 0xFD, 15708, 500, NONE))).cog_deg == east.hdg_deg
assert abs(decode(line(128259, struct.pack("<BHHBB", 1, ERROR, NONE, 255, 255))).stw_kn - 1273.88) < 0.01
assert decode(line(128267, struct.pack("<BIhB", 1, 2**32 - 2, 0, 255))).depth_m > 42e6
assert decode(line(129025, struct.pack("<ii", 2**31 - 2, 2**31 - 2))).lat > 214

for read, error in ((by_n2k, 6.5534), (by_nmea2k, 6.5534), (by_nmea2000, None)):
    print(read.__name__, read(right), read(wrong), read(none))
    assert abs(read(right)[0] - 1.5708) < 1e-6 and read(right)[1].lower() == "magnetic" and read(none)[0] is None
    assert read(wrong)[0] == error or abs(read(wrong)[0] - error) < 1e-6

lines = [line(127250, data) for data in (right, wrong, none)]
found = json.loads(subprocess.run(["node", "read.cjs", *lines], check=True, capture_output=True, text=True).stdout)
print("by canboatjs:", found)
assert found == [1.5708, None, None]
PYTHON
