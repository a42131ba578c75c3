#!/usr/bin/env bash
# A GNSS receiver with inertial sensors sends raw values. What do two parsers of one family make of a rotation of -12.5 degrees per
# second (UBX-ESF-MEAS, 24 bits, two's complement), and of a satellite whose range is marked as invalid (RTCM 1074, DF397 = 255)?
# Guess: numbers as the specification means them, signed and scaled, as for other fields of these messages; nothing for what is invalid.
# Seen on 2026-11-28:
# - pyubx2 1.4.0: the rate is 16726016, while the rates of UBX-ESF-INS from the same parser are signed and in degrees per second.
#   16777216 less is -51200, of which 4096 are a degree per second; no function of it says so (`val2twoscomp` goes the other way). In
#   UBX-ESF-RAW the same number is four bytes with its type.
# - pyrtcm 1.2.1: the invalid range is 255 ms, 76,000 km, and the invalid fine range beside it -2^-10 ms: a sum that looks like a range
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check pyubx2==1.4.0 pyrtcm==1.2.1
cd "$folder"
venv/bin/python - <<'PYTHON'
import struct

from pyrtcm import RTCMMessage
from pyubx2 import GET, UBXMessage, UBXReader

RAW = round(-12.5 * 4096)
GYROSCOPE_Z = 5


def parsed(number, payload):
    return UBXReader.parse(UBXMessage(b"\x10", number, GET, payload=payload).serialize())


word = struct.pack("<I", RAW & 0xFFFFFF | GYROSCOPE_Z << 24)
measured = parsed(b"\x02", struct.pack("<IHH", 1000, 1 << 11, 0) + word)
fused = parsed(b"\x15", struct.pack("<I4sIiiiiii", 0x3F << 8 | 1, bytes(4), 1000, 0, 0, -12500, 0, 0, 0))
raw = parsed(b"\x03", bytes(4) + word + bytes(4))
print(measured.dataType_01, measured.dataField_01, fused.zAngRate, raw.data_01)
assert (measured.dataType_01, measured.dataField_01) == (GYROSCOPE_Z, RAW + 2**24)
assert fused.zAngRate == -12.5
assert raw.data_01 == word

FIELDS = (  # number and bits of MSM4 for GPS: header, masks of one satellite with one signal, its ranges
    (1074, 12), (1, 12), (345_600_000, 30), (0, 1), (0, 3), (0, 7), (0, 2), (0, 2), (0, 1), (0, 3),
    (1 << 59, 64), (1 << 30, 32), (1, 1), (255, 8), (0, 10), (1 << 14, 15), (1 << 21, 22), (5, 4), (0, 1), (0, 6),
)
bits = "".join(f"{number:0{size}b}" for number, size in FIELDS)
bits += "0" * (-len(bits) % 8)
message = RTCMMessage(payload=int(bits, 2).to_bytes(len(bits) // 8, "big"))
print(message.PRN_01, message.DF397_01, message.DF400_01)
assert (message.DF397_01, message.DF400_01) == (255, -(2.0**-10))
PYTHON
