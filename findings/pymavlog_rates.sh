#!/usr/bin/env bash
# A drone logs two accelerometers (ArduPilot, DataFlash, messages IMU with I = 0 and 1) at 400 Hz, each of its own instants, and is read with pymavlog at a lower
# rate: `MavLog(file, max_rate_hz=...)`. Guess: at 150 and 50 Hz 133 and 50 samples a second of each.
# Seen with pymavlog 0.4.2 and pymavlink 2.4.50 on 2026-11-30, without a word: at 150 Hz 134 of the first and NONE of the second, as one clock
# runs for messages of a name, whichever sensor they are of; at 50 Hz 18 of the first and 30 of the second, by turns.
# Without `max_rate_hz` it has 400 of each.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check pymavlog==0.4.2 pymavlink==2.4.50 numpy==1.26.4 lxml==6.1.3 2>/dev/null
cat > rates.py <<'PYTHON'
import struct
from pathlib import Path

import numpy as np
from pymavlog import MavLog


def message(kind, layout, *values):
    return b"\xa3\x95" + struct.pack("<B" + layout, kind, *values)


def definition(kind, layout, name, letters, columns):
    return message(128, "BB4s16s64s", kind, 3 + struct.calcsize("<" + layout), name, letters, columns)


log = definition(128, "BB4s16s64s", b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns")
log += definition(130, "QBIH", b"GPS", b"QBIH", b"TimeUS,Status,GMS,GWk")
log += definition(131, "QB3f", b"IMU", b"QBfff", b"TimeUS,I,AccX,AccY,AccZ")
log += message(130, "QBIH", 2_000_000, 3, 345_618_000, 2288)
for number in range(400):
    for sensor in (0, 1):
        log += message(131, "QB3f", 2_000_000 + 2500 * number + 1250 * sensor, sensor, 0, 0, -9.8)
Path("drone.bin").write_bytes(log)

seen = {None: (400, 400), 150: (134, 0), 50: (18, 30)}
for rate_hz, expected in seen.items():
    read = MavLog("drone.bin", max_rate_hz=rate_hz)
    read.parse()
    imu = read["IMU"].fields
    times_us = [imu["TimeUS"][imu["I"] == sensor] for sensor in (0, 1)]
    gaps_s = [round(float(np.diff(times).max()) / 1e6, 4) if len(times) else None for times in times_us]
    print(f"at most {rate_hz} Hz: {[len(times) for times in times_us]} samples in a second, gaps of up to {gaps_s} s")
    assert tuple(len(times) for times in times_us) == expected
PYTHON
venv/bin/python rates.py 2> said.txt || { tail -5 said.txt; exit 1; }
if grep -i warn said.txt; then exit 1; fi
