#!/usr/bin/env bash
# A boat's AIS receiver hears a ship that has no position, speed, course and heading at the moment; and a script sends a report of its own, of which it knows the position
# alone. AIS has numbers that mean "not available". What does pyais read, and what does it write?
# Guess: None for what is not available; and "not available" for what was not given. Seen with pyais 3.3.1 on 2026-11-29, without a word:
# - read: latitude 91, longitude 181, speed 102.3 knots, course 360, heading 511 and second 60, floats and integers like any other. Only the rate of turn is an
#   enumeration then (`TurnRate.NO_TI_DEFAULT`), in a column that otherwise has floats; it is -128.0 as a number
# - written: speed 0, course 0 and heading 0: the ship lies still, with its bow to the north. Without a position it is at 0, 0, in the Gulf of Guinea; only the rate of
#   turn is "not available"
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check pyais==3.3.1
"$folder/venv/bin/python" - <<'PYTHON'
from pyais import decode, encode_dict


def bits(value, width):
    """Return a number as that many bits, by two's complement."""
    return f"{value & (1 << width) - 1:0{width}b}"


def sentence(payload):
    """Return the sentence of NMEA that carries these bits."""
    signs = "".join(chr(value + 48 if value < 40 else value + 56) for value in (int(payload[at : at + 6], 2) for at in range(0, len(payload), 6)))
    body = f"AIVDM,1,1,,A,{signs},0"
    check = 0
    for letter in body.encode():
        check ^= letter
    return f"!{body}*{check:02X}".encode()


heard = bits(1, 6) + bits(0, 2) + bits(211000000, 30) + bits(15, 4) + bits(-128, 8) + bits(1023, 10) + bits(0, 1)
heard += bits(181 * 600000, 28) + bits(91 * 600000, 27) + bits(3600, 12) + bits(511, 9) + bits(60, 6) + bits(0, 25)
ship = decode(sentence(heard)).asdict()
names = ("lat", "lon", "speed", "course", "heading", "second", "turn")
print("heard without position and motion:", {name: ship[name] for name in names})
assert [ship[name] for name in names[:-1]] == [91, 181, 102.3, 360, 511, 60]
assert type(ship["turn"]).__name__ == "TurnRate" and ship["turn"] == -128

own = decode(*encode_dict({"msg_type": 1, "mmsi": 211000000, "lat": 54.5, "lon": 10.25})).asdict()
print("written with a position alone:    ", {name: own[name] for name in names})
assert [own[name] for name in names[:5]] == [54.5, 10.25, 0, 0, 0] and own["turn"] == -128
nowhere = decode(*encode_dict({"msg_type": 1, "mmsi": 211000000})).asdict()
assert (nowhere["lat"], nowhere["lon"]) == (0, 0)
PYTHON
