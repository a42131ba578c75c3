#!/usr/bin/env bash
# What do two NMEA parsers make of a leap second, of more digits than microseconds, and of a sentence without a fix (status V)?
# Guess: both have the same time, or an error; without a fix there is no position. Seen on 2026-11-28:
#   235960.00 (31 Dec 2016)  pynmea2 1.19.0: it parses, then `.datetime` is a TypeError; pynmeagps 1.1.8: `.time` is '', without a word
#   123519.1234567           pynmea2: cut to microseconds; pynmeagps: `.time` is '', without a word
#   status V, empty fields   pynmea2: latitude 0.0, longitude 0.0, a position in the Gulf of Guinea; pynmeagps: '' and ''
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check pynmea2==1.19.0 pynmeagps==1.1.8
"$folder/venv/bin/python" - <<'PYTHON'
import functools
import operator

import pynmea2
import pynmeagps


def both(body):
    """Return what either library makes of a sentence without its frame."""
    checksum = functools.reduce(operator.xor, body.encode())
    sentence = f"${body}*{checksum:02X}\r\n"
    return pynmea2.parse(sentence), pynmeagps.NMEAReader.parse(sentence)


FIX = "A,4807.038,N,01131.000,E,022.4,084.4"
leap = both(f"GPRMC,235960.00,{FIX},311216,,,A")
try:
    leap[0].datetime
except TypeError as error:
    print(f"leap second: pynmea2 {error!r}, pynmeagps {leap[1].time!r}")
else:
    raise SystemExit("pynmea2 knows leap seconds now")
assert leap[1].time == ""

digits = both(f"GPRMC,123519.1234567,{FIX},281126,,,A")
print(f"seven digits: pynmea2 {digits[0].datetime.time()}, pynmeagps {digits[1].time!r}")
assert digits[0].datetime.microsecond == 123456
assert digits[1].time == ""

nowhere = both("GPRMC,123519.00,V,,,,,,,281126,,,N")
print("no fix: pynmea2", (nowhere[0].latitude, nowhere[0].longitude), "pynmeagps", (nowhere[1].lat, nowhere[1].lon))
assert (nowhere[0].latitude, nowhere[0].longitude) == (0.0, 0.0)
assert (nowhere[1].lat, nowhere[1].lon) == ("", "")
PYTHON
