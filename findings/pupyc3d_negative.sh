#!/usr/bin/env bash
# A marker of motion capture is 250 mm left of the room's middle (y = -250 mm), a force plate is pressed by 700 N (z = -700 N), and in the second frame the marker is hidden (residual -1). The take is C3D
# of integers, as Vicon and others wrote it for decades: 16 bits times a scale, in which about half of all numbers are negative. Guess: y = -250 mm, z = -700 N, a residual of -1, as with ezc3d and c3d.
# Seen with pupyC3D 0.1.3 beside ezc3d 1.7.2 and c3d 0.6.0 on 2026-11-30, without a word: y = 6303.6 mm, z = 12407.2 N, and the hidden marker is at the origin with a residual of 6553.5: integers are read
# as if they had no sign, so whatever is negative is 65536 steps too far. ezc3d, c3d: as guessed (c3d keeps the residual of -1 and the origin, ezc3d has NaN). Takes of floats are right.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check pupyC3D==0.1.3 ezc3d==1.7.2 c3d==0.6.0 numpy==2.4.6 2>/dev/null
cat > take.py <<'PYTHON'
import struct
from pathlib import Path

import c3d
import ezc3d
import numpy as np
from pupyC3D import C3DFile

SCALE_MM, SCALE_N, RATE_HZ = 0.1, 0.2, 100.0
PLACES = [(1500, -2500, 9000, 0), (0, 0, 0, -1)]  # x, y, z in steps, and the mask of cameras with the residual
FORCE = -3500


def parameter(group, name, form, dimensions, data):
    head = struct.pack("<bb", len(name), group) + name.encode()
    body = struct.pack("<bB", form, len(dimensions)) + bytes(dimensions) + data + b"\x00"
    return head + struct.pack("<H", len(body) + 2) + body


def group(number, name):
    return struct.pack("<bb", len(name), -number) + name.encode() + struct.pack("<HB", 3, 0)


def write(path):
    """Write two frames of one marker and one analog channel, in integers."""
    blocks = group(1, "POINT") + parameter(1, "USED", 2, [], struct.pack("<h", 1)) + parameter(1, "SCALE", 4, [], struct.pack("<f", SCALE_MM))
    blocks += parameter(1, "RATE", 4, [], struct.pack("<f", RATE_HZ)) + parameter(1, "DATA_START", 2, [], struct.pack("<h", 3))
    blocks += parameter(1, "FRAMES", 2, [], struct.pack("<h", 2)) + parameter(1, "LABELS", -1, [4, 1], b"LEFT") + parameter(1, "UNITS", -1, [2], b"mm")
    blocks += parameter(1, "DESCRIPTIONS", -1, [4, 1], b"LEFT") + parameter(2, "DESCRIPTIONS", -1, [2, 1], b"FZ")
    blocks += group(2, "ANALOG") + parameter(2, "USED", 2, [], struct.pack("<h", 1)) + parameter(2, "RATE", 4, [], struct.pack("<f", RATE_HZ))
    blocks += parameter(2, "GEN_SCALE", 4, [], struct.pack("<f", 1.0)) + parameter(2, "SCALE", 4, [1], struct.pack("<f", SCALE_N))
    blocks += parameter(2, "OFFSET", 2, [1], struct.pack("<h", 0)) + parameter(2, "LABELS", -1, [2, 1], b"FZ") + parameter(2, "UNITS", -1, [1, 1], b"N")
    blocks = (b"\x01\x50\x01\x54" + blocks + b"\x00\x00").ljust(512, b"\x00")
    header = struct.pack("<BBHHHHHfHHf", 2, 80, 1, 1, 1, 2, 10, SCALE_MM, 3, 1, RATE_HZ).ljust(512, b"\x00")
    data = b"".join(struct.pack("<hhhhh", *place, FORCE) for place in PLACES)
    Path(path).write_bytes(header + blocks + data.ljust(512, b"\x00"))


write("take.c3d")
seen = {}
take = C3DFile("take.c3d")
seen["pupyC3D"] = take.data["POINTS"]["LEFT"][0, 1], take.data["ANALOGS"]["FZ"][0, 0], take.data["POINTS"]["LEFT"][1]
take = ezc3d.c3d("take.c3d")
seen["ezc3d"] = take["data"]["points"][1, 0, 0], take["data"]["analogs"][0, 0, 0], take["data"]["points"][:, 0, 1]
with Path("take.c3d").open("rb") as file:
    (_, points, analog), (_, hidden, _) = c3d.Reader(file).read_frames()
seen["c3d"] = points[0, 1], analog[0, 0], hidden[0]
for name, (y_mm, force_n, place) in seen.items():
    print(f"{name}: y {y_mm:.1f} mm, force {force_n:.1f} N, hidden marker {np.round(place, 1)}")
assert np.allclose(seen["pupyC3D"][:2], [6303.6, 12407.2]) and np.allclose(seen["pupyC3D"][2], [0, 0, 0, 6553.5])
assert all(np.allclose(seen[name][:2], [-250, -700]) for name in ("ezc3d", "c3d"))
assert np.isnan(seen["ezc3d"][2][:3]).all() and seen["c3d"][2][3] == -1
PYTHON
venv/bin/python -W error take.py
