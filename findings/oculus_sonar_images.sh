#!/usr/bin/env bash
# The log of an imaging sonar (Oculus, .oculus version 1) has three pings, 0.25 s apart, with a target at 5.05 m and 35.9 degrees. Its 256 beams are not evenly spaced: each ping has a table
# of their bearings, here even in the sine, as a row of receivers has them. oculus-python makes Cartesian images and converts the log into version 2, which it reads, too.
# Guess: the target at (2.96, 4.09) m, and 0.25 s between pings. Seen with oculus-python 0.0.2a1 and numpy 1.26.4 on 2026-11-30, without a word:
# - the target is at (3.32, 3.74), at 41.6 degrees: the table of bearings is read, and `polar_to_cart`, with which videos are made, too, takes its first and last alone, and
#   beams in between as evenly spaced. In the middle and at both ends it is right
# - converted, pings are 0.25 ms apart, in January 1970: version 2 has milliseconds, which are read as such, and seconds are written. A video has 10 pings a second, whatever their times
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check oculus-python==0.0.2a1 numpy==1.26.4 opencv-python==4.11.0.86 netCDF4==1.7.5.1.post1 rosbags==0.11.9
cd "$folder"
venv/bin/python - <<'PYTHON'
import struct
from pathlib import Path

import numpy as np
from bps_oculus import core, io
from bps_oculus.logger import v1

RANGES, BEAMS, STEP_M = 200, 256, 0.05
HALF = np.sin(np.radians(65))
BEARINGS = np.degrees(np.arcsin(np.linspace(-HALF, HALF, BEAMS)))


def ping(number, target):
    """Return a ping (version 2, 8 bits) of a target of 3 x 3 around (range, beam)."""
    image = np.zeros((RANGES, BEAMS), np.uint8)
    image[target[0] - 1 : target[0] + 2, target[1] - 1 : target[1] + 2] = 255
    offset = 202 + 2 * BEAMS
    head = struct.pack("<5HIH", 0x4F53, 1, 0, 0x23, 2, offset + image.size - 16, 0)
    fire = struct.pack("<5B4d9I", 1, 0, 0xFF, 127, 0x19, 10.0, 50.0, 1500.0, *[0] * 10)
    result = struct.pack("<II8dBd", number, 0, 1.2e6, 15.0, 1.0, 0, 0, 0, 1500.0, 0, 0, STEP_M)
    result += struct.pack("<2H7I", RANGES, BEAMS, 0, 0, 0, 0, offset, image.size, offset + image.size)
    return head + fire + result + (BEARINGS * 100).round().astype("<i2").tobytes() + image.tobytes()


def write(path, targets):
    with open(path, "wb") as file:
        file.write(v1.RmLogHeader(v1.s_fileHeader, v1.RmLogHeader.size(), "Oculus", 1, 0, 0, 1.7e9).pack())
        for number, target in enumerate(targets):
            data = ping(number, target)
            kind, time_s = int(v1.eRecordTypes.rt_oculusSonar), 1.7e9 + number / 4
            file.write(v1.RmLogItem(v1.s_itemHeader, v1.RmLogItem.size(), kind, 2, time_s, 0, len(data), len(data)).pack())
            file.write(data)


targets = [(100, 210), (100, 128), (100, 250)]
write(Path("dive.oculus"), targets)
times = []
for (row, beam), (info, _, polar, _) in zip(targets, io.ImporterV1(Path("dive.oculus")).generate(), strict=True):
    times.append(info.timestamp)
    assert np.isclose(np.degrees(polar.bearing_table[beam]), BEARINGS[beam], atol=0.01)
    image = core.polar_to_cart(polar)
    weights = image.cart_image / image.cart_image.sum()
    x_m, y_m = ((weights * table).sum() for table in (image.x_table, image.y_table))
    bearing = np.degrees(np.arctan2(x_m, y_m))
    print(f"{np.hypot(x_m, y_m):.2f} m at {bearing:.1f} degrees, of {polar.ranging_table[row]:.2f} m at {BEARINGS[beam]:.1f}")
    assert abs(np.hypot(x_m, y_m) - 5.05) < 0.1
    assert np.isclose(bearing - BEARINGS[beam], 5.7 if beam == 210 else 0, atol=0.6 if beam == 210 else 2.5)
assert np.allclose(np.diff(times), 0.25)

list(io.to_bpsv2(io.ImporterV1(Path("dive.oculus")), Path("dive.oculus")))
converted = [info.timestamp for info, *_ in io.ImporterV2(Path("dive.v2.oculus")).generate()]
print(times, "s become", converted)
assert np.allclose(converted, np.array(times) / 1000, rtol=0, atol=1e-9)
PYTHON
