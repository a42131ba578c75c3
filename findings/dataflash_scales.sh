#!/usr/bin/env bash
# A log of ArduPilot (DataFlash, .bin) has the position of a drone as degrees times 1e7, its height and temperature in hundredths, and the pressure in thousandths of a
# pascal; formats (`L`, `c`, `e`) tell of the first three, and a message FMTU of the multiplier of each. Three libraries read it to dictionaries of the same names.
# Guess: degrees, metres, degrees Celsius and pascals, by all of them; or the raw integers, by all of them.
# Seen with pymavlink 2.4.50, mavparser 0.0.1 and UAVReaders 1.0.6 on 2026-11-29, without a word:
#   pymavlink, mavparser   48.1234567, 500.5, 21.5 by the format, and 101,325,000: multipliers of FMTU are not applied. pymavlink has "mPa" as the unit
#                          of that field, which its dictionary has not
#   UAVReaders             481234567, 50050, 2150 and 101,325,000: nothing is scaled, and formats are not there to be asked
# So a script that goes from one to the other is off by 1e7; and in one row of the first two some numbers are scaled and others are not, with no mark of which.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3.11 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check pymavlink==2.4.50 mavparser==0.0.1 UAVReaders==1.0.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import struct

import mavparser
import UAVReaders
from pymavlink import mavutil


def message(kind, layout, *values):
    return b"\xa3\x95" + struct.pack("<B" + layout, kind, *values)


def definition(kind, layout, name, letters, columns):
    return message(128, "BB4s16s64s", kind, 3 + struct.calcsize("<" + layout), name, letters, columns)


log = definition(128, "BB4s16s64s", b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns")
log += definition(140, "Qb64s", b"UNIT", b"QbZ", b"TimeUS,Id,Label")
log += definition(141, "Qbd", b"MULT", b"Qbd", b"TimeUS,Id,Mult")
log += definition(142, "QB16s16s", b"FMTU", b"QBNN", b"TimeUS,FmtType,UnitIds,MultIds")
log += definition(130, "QiihI", b"FLY", b"QLecI", b"TimeUS,Lat,Alt,Temp,Press")
for unit, label in ((b"s", b"s"), (b"D", b"deg"), (b"m", b"m"), (b"O", b"degC"), (b"P", b"Pa")):
    log += message(140, "Qb64s", 1, ord(unit), label)
for letter, factor in ((b"F", 1e-6), (b"G", 1e-7), (b"B", 1e-2), (b"C", 1e-3)):
    log += message(141, "Qbd", 1, ord(letter), factor)
log += message(142, "QB16s16s", 1, 130, b"sDmOP", b"FGBBC")
log += message(130, "QiihI", 2_000_000, 481_234_567, 50_050, 2_150, 101_325_000)
with open("drone.bin", "wb") as file:
    file.write(log)

row = mavutil.mavlink_connection("drone.bin").recv_match(type="FLY")
print(f"pymavlink: {row.to_dict()}, units {row.fmt.units}")
(of_mavparser,) = [row for row in mavparser.parse("drone.bin") if row["mavpackettype"] == "FLY"]
(of_uavreaders,) = [dict(row) for row in UAVReaders.data_flash_reader("drone.bin")() if "Press" in row]
print(f"mavparser: {of_mavparser}\nUAVReaders: {of_uavreaders}")
scaled, raw = (48.1234567, 500.5, 21.5, 101_325_000), (481_234_567, 50_050, 2_150, 101_325_000)
for found, expected in ((row.to_dict(), scaled), (of_mavparser, scaled), (of_uavreaders, raw)):
    assert all(abs(found[name] - number) < 1e-9 for name, number in zip(("Lat", "Alt", "Temp", "Press"), expected)), found
assert row.fmt.units[4] == "mPa"
PYTHON
