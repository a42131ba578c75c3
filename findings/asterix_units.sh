#!/usr/bin/env bash
# An airliner over a radar: a block of ASTERIX category 48 and two tracks of category 62, the samples that asterix-decoder comes with, are decoded by it, by asterix4py and by aviconv-asterix, to become the truth
# of what a camera on the ground sees. Guess: the same speeds, levels and pressures, in the same units.
# Seen on 2026-11-30, without a word:
# - the pilots' setting of the barometer (BDS 4,0) is 227 mb by asterix-decoder 0.7.11, 1027 by pyModeS 3.6.1: it is sent as what it is above 800, which nobody adds
# - asterix-decoder has flight levels in category 48 (`FL` of 330) and feet in category 62 (`MFL`, "measured flight level", and `CTBA`, of 15700), as `CFL`, beside them, is of
#   350 levels again; aviconv-asterix 0.4.0 has 157 and 350 for both
# - a speed is 434.94 knots by asterix4py 1.0.6, 434.40 by the others: its step is 0.22 knots, where it is 1/16384 of a mile per second; half a mile after an hour
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check asterix_decoder==0.7.11 asterix4py==1.0.6 aviconv-asterix==0.4.0 pyModeS==3.6.1 lxml==6.1.3 2>/dev/null
cat > units.py <<'PYTHON'
from pathlib import Path

import asterix
import asterix4py
import aviconv_asterix
import pyModeS

radar, tracks = (Path(asterix.get_sample_file(name)).read_bytes() for name in ("cat048.raw", "cat062cat065.raw"))

(plane,) = asterix.parse(radar)
register = plane["I250"][0]
mode_s = bytes.fromhex(plane["hexdata"])
begin = mode_s.index(bytes.fromhex("C0780031BC0000"))
right = pyModeS.decode("A0000A3C" + mode_s[begin : begin + 7].hex().upper() + "000000")
print("barometer:", register["BP"]["val"], "by asterix-decoder,", right["baro_pressure_setting"], "mb by pyModeS; altitude", register["MCP_ALT"]["val"], right["selected_altitude_mcp"])
assert (register["BP"]["val"], right["baro_pressure_setting"]) == (227, 1027) and register["MCP_ALT"]["val"] == right["selected_altitude_mcp"] == 33008

first, second, _ = asterix.parse(tracks)
known = [record.measured_flight_level for record in aviconv_asterix.iter_records(tracks[: first["len"] + second["len"] + 3])]
levels = [track["I136"]["MFL"]["val"] for track in (first, second)]
print("category 48: FL", plane["I090"]["FL"]["val"], "category 62: MFL", levels, "CFL", second["I390"]["CFL"]["CFL"]["val"], "and by aviconv-asterix", known)
assert plane["I090"]["FL"]["val"] == 330 and levels == [15700, 35000] and second["I390"]["CFL"]["CFL"]["val"] == 350
assert first["I135"]["CTBA"]["val"] == 15700 and known == [157, 350]

speeds = [plane["I200"]["CGS"]["val"], next(aviconv_asterix.iter_records(radar)).ground_speed_kt, asterix4py.AsterixParser(radar).get_result()[1]["200"]["CGS"]]
print("knots:", speeds, "and", 0x07B9 * 3600 / 16384, "is right")
assert speeds == [434.3994140625, 434.3994140625, 434.94] and speeds[0] == 0x07B9 * 3600 / 16384
PYTHON
venv/bin/python units.py > said.txt 2>&1 || { tail -8 said.txt; exit 1; }
if grep -i warn said.txt; then exit 1; fi
cat said.txt
