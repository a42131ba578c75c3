#!/usr/bin/env bash
# Two flights of an ArduPilot drone are two DataFlash logs (.bin). Both are opened with MAVdataflash, then a table is made of each: `GetData("BARO")`, heights of
# 10 m in the first flight and of 50 m in the second, by the drone's clock from 2 s on. Guess: each object has its own flight.
# Seen with MAVdataflash 3.0.0 (polars 2.1.0, pymavlink 2.4.50) on 2026-11-30, without a word: both have the flight that was asked for first. Tables are kept
# in the class, not in the object, and a table that is there is not read again; opening a log empties them. So flights that are opened one after the other
# and read one after the other are all the first one, and which one it is depends on the order of reading; opened and read by turns, they are right
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check mavdataflash==3.0.0 pymavlink==2.4.50 polars==2.1.0 pandas==3.1.1 pyarrow==26.0.1
cd "$folder"
venv/bin/python - <<'PYTHON'
import struct

from MAVdataflash import DataFlash


def message(kind, layout, *values):
    return b"\xa3\x95" + struct.pack("<B" + layout, kind, *values)


def definition(kind, layout, name, letters, columns):
    return message(128, "BB4s16s64s", kind, 3 + struct.calcsize("<" + layout), name, letters, columns)


def flight(name, height_m, rows):
    log = definition(128, "BB4s16s64s", b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns")
    log += definition(130, "Qf", b"BARO", b"Qf", b"TimeUS,Alt")
    for row in range(rows):
        log += message(130, "Qf", 2_000_000 + 100_000 * row, height_m)
    with open(name, "wb") as file:
        file.write(log)
    return name


def heights_m(log):
    return log.GetData("BARO")["Alt"].tolist()


files = [flight("first.bin", 10.0, 3), flight("second.bin", 50.0, 4)]
logs = [DataFlash(name) for name in files]
together = [heights_m(log) for log in logs]
logs = [DataFlash(name) for name in files]
backwards = [heights_m(log) for log in reversed(logs)]
by_turns = [heights_m(DataFlash(name)) for name in files]
print("both opened, then read:", together, "- in the other order:", backwards, "- opened and read by turns:", by_turns)
assert together == [[10.0] * 3] * 2
assert backwards == [[50.0] * 4] * 2
assert by_turns == [[10.0] * 3, [50.0] * 4]
PYTHON
