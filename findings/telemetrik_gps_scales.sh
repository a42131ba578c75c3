#!/usr/bin/env bash
# A GoPro on a robot is at 48.1234567 N, 11.5678901 E, 520 m high, and drives at 10 m/s. A fix in its telemetry (GPMF, GPS5) is five integers, and SCAL beside it has a divisor for each: 1e7, 1e7, 1000, 1000
# and 100. Acceleration has one divisor for three axes. The video is read with telemetrik, and with gpmf. Guess: these numbers, in "deg,deg,m,m/s,m/s,fix,dop", as its result says. DOP is 1.5.
# Seen with telemetrik 0.1.0 beside gpmf 0.1 on 2026-11-30, without a word: 0.052 m high, 0.001 m/s and 0.0001 m/s: all five are divided by the first divisor; "dop" is 150. Latitude, longitude and acceleration
# are right, so the track looks right on a map; speeds by GPS are a ten-thousandth, or a hundred-thousandth for the one in 3D. gpmf: as guessed.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check --no-deps telemetrik==0.1.0 gpmf==0.1 gpxpy==1.6.2 numpy==2.4.6 2>/dev/null
sed -i '/gps_plot/d' venv/lib/python3*/site-packages/gpmf/__init__.py  # drawing maps, which needs much more
cat > video.py <<'PYTHON'
import struct
from pathlib import Path

import gpmf
import numpy as np
from telemetrik import extract_all_telemetry

LATITUDE_DEG, LONGITUDE_DEG, HEIGHT_M, SPEED_M_S, DOP = 48.1234567, 11.5678901, 520.0, 10.0, 1.5
DIVISORS = (10**7, 10**7, 1000, 1000, 100)


def item(key, kind, size, payload):
    """Return an item of GPMF: a name, a type, the size of an element, how many, and the bytes, padded to four."""
    return key + struct.pack(">cBH", kind, size, len(payload) // size) + payload + bytes(-len(payload) % 4)


def nested(key, payload):
    return key + struct.pack(">cBH", b"\0", 1, len(payload)) + payload


def second(number):
    """Return the telemetry of a second: ten fixes and 200 accelerations, at rest with 9.81 m/s2 along the first axis."""
    time = item(b"STMP", b"J", 8, struct.pack(">Q", number * 10**6))
    values = (LATITUDE_DEG, LONGITUDE_DEG, HEIGHT_M, SPEED_M_S, SPEED_M_S)
    fix = struct.pack(">5i", *(round(value * divisor) for value, divisor in zip(values, DIVISORS)))
    gps = time + item(b"STNM", b"c", 1, b"GPS (Lat., Long., Alt., 2D speed, 3D speed)") + item(b"GPSF", b"L", 4, struct.pack(">I", 3))
    gps += item(b"GPSU", b"U", 16, b"261130%06d.000" % (100_000 + number)) + item(b"GPSP", b"S", 2, struct.pack(">H", round(100 * DOP)))
    gps += item(b"UNIT", b"c", 3, b"degdegm\0\0m/sm/s") + item(b"SCAL", b"l", 4, struct.pack(">5i", *DIVISORS)) + item(b"GPS5", b"l", 20, fix * 10)
    rest = time + item(b"STNM", b"c", 1, b"Accelerometer") + item(b"SCAL", b"s", 2, struct.pack(">h", 417)) + item(b"ACCL", b"s", 6, struct.pack(">3h", 4091, 0, 0) * 200)
    return nested(b"DEVC", nested(b"STRM", gps) + nested(b"STRM", rest))


def box(key, payload):
    return struct.pack(">I", 8 + len(payload)) + key + payload


def video(path, blocks):
    """Write an MP4 with a telemetry track alone, of a block a second."""
    data = box(b"ftyp", b"mp41" + bytes(4)) + box(b"mdat", b"".join(blocks))
    starts = [len(data) - sum(len(block) for block in blocks[number:]) for number in range(len(blocks))]
    table = box(b"stsz", struct.pack(">III", 0, 0, len(blocks)) + b"".join(struct.pack(">I", len(block)) for block in blocks))
    table += box(b"stco", struct.pack(">II", 0, len(blocks)) + b"".join(struct.pack(">I", start) for start in starts))
    table += box(b"stts", struct.pack(">IIII", 0, 1, len(blocks), 1000))
    media = box(b"mdhd", struct.pack(">IIIIII", 0, 0, 0, 1000, 1000 * len(blocks), 0)) + box(b"minf", box(b"gmhd", box(b"gpmd", bytes(4))) + box(b"stbl", table))
    Path(path).write_bytes(data + box(b"moov", box(b"trak", box(b"mdia", media))))


blocks = [second(number) for number in range(3)]
video("GX010001.MP4", blocks)
streams = extract_all_telemetry("GX010001.MP4")
fixes, rest = streams["GPS5"], np.array([value for _, value in streams["ACCL"].data])
(fix,) = {value for _, value in fixes.data}
print("telemetrik:", fixes.units, fix)
assert fixes.sample_count == 30 and fixes.units == "deg,deg,m,m/s,m/s,fix,dop"
assert np.allclose(fix[:2], [LATITUDE_DEG, LONGITUDE_DEG], rtol=0, atol=1e-9) and np.allclose(rest, [9.81, 0, 0], atol=0.002)
assert np.allclose(fix[2:], [HEIGHT_M / 1e4, SPEED_M_S / 1e4, SPEED_M_S / 1e5, 3, 100 * DOP])
right = gpmf.gps.parse_gps_block(next(gpmf.gps.extract_gps_blocks(blocks[0])))
print("gpmf:", right.latitude[0], right.longitude[0], right.altitude[0], right.speed_2d[0], right.speed_3d[0], right.precision)
assert [right.altitude[0], right.speed_2d[0], right.speed_3d[0], right.precision] == [HEIGHT_M, SPEED_M_S, SPEED_M_S, DOP]
PYTHON
venv/bin/python -W error video.py
