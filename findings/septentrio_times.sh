#!/usr/bin/env bash
# A Septentrio receiver sends its position (SBF, PVTGeodetic) on a Thursday, 18 s after midnight in GPS time, and then loses it. What does pysbf2 make of the blocks?
# Guess: degrees, as its sisters pyubx2 and pynmeagps have; a time of week; None, or nothing, where the receiver says "do not use" (-2e10, 65535, 255).
# Seen with pysbf2 1.0.7 on 2026-11-29, without a word:
# - latitude and longitude in radians, 0.84 and 0.2, as the receiver sends them; under the names that hold degrees in the other two
# - printed, `TOW` is a time of DAY, in UTC (00:00:00), beside `WNc`, the number of the week: Thursday's block looks like Sunday's. As an attribute it is milliseconds of the
#   week in GPS time: 345618000. "No time" (4294967295) is printed as 17:02:29.295000
# - what is not there is a number like any other: a height of -2e10 m, 255 satellites, an accuracy of 655.35 m
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check pysbf2==1.0.7
cd "$folder"
venv/bin/python - <<'PYTHON'
import io
import struct

from pysbf2 import SBFReader
from pysbf2.sbfhelpers import calc_crc

NOT_USED = -2e10


def position(tow_ms, latitude_rad, longitude_rad, height_m, satellites, accuracy):
    """Return what is read of a block PVTGeodetic."""
    body = struct.pack("<IHBBddd", tow_ms, 2288, 1, 0, latitude_rad, longitude_rad, height_m) + struct.pack("<5f", 47, 0, 0, 0, NOT_USED)
    body += struct.pack("<dfBBBBHHIBBHHHB", 0, 0, 0, 0, satellites, 0, 0, 65535, 0, 0, 0, 65535, accuracy, accuracy, 0)
    body += bytes(-len(body) % 4)
    block = struct.pack("<HH", 4007, 8 + len(body)) + body
    ((_, parsed),) = SBFReader(io.BytesIO(b"$@" + struct.pack("<H", calc_crc(block)) + block))
    return parsed


day_ms = 86_400_000
thursday, sunday = (position(days * day_ms + 18_000, 0.84, 0.2, 500.0, 12, 150) for days in (4, 0))
print(thursday)
assert (thursday.Latitude, thursday.Longitude) == (0.84, 0.2)
assert (thursday.TOW, sunday.TOW) == (345_618_000, 18_000)
assert str(thursday) == str(sunday) and "TOW=00:00:00, WNc=2288" in str(thursday)
lost = position(0xFFFFFFFF, NOT_USED, NOT_USED, NOT_USED, 255, 65535)
print(lost)
assert "TOW=17:02:29.295000" in str(lost)
assert (lost.Latitude, lost.Height, lost.NrSV) == (-2e10, -2e10, 255)
assert abs(lost.HAccuracy - 655.35) < 1e-9
PYTHON
