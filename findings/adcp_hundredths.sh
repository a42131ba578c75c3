#!/usr/bin/env bash
# A Doppler profiler of Teledyne RDI, as a DVL or ADCP under a vehicle is, pings 4 times a second, and logs PD0: a ping has a time of day to hundredths of a second, one byte.
# Which times do two readers give to the pings of 2 s? Guess: 0, 0.25, 0.5, 0.75, 1 s and so on, in both. Seen on 2026-12-01, without a word:
#   trdi-adcp-readers 25.6.4   0, 0.000025, 0.00005, 0.000075, 1 s: hundredths are microseconds. And of a file, the first ping is all that it returns (`read_PD0_file`)
#   adcpreader 0.2.1           0, 0.025, 0.05, 0.075, 1 s: hundredths are milliseconds (`Timestamp`)
# Pings stand in bursts at whole seconds, so what is joined to them by nearest time, or integrated, is up to 0.99 s early; rates by differences are 40 Hz and 1.1 Hz by turns.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check trdi-adcp-readers==25.6.4 adcpreader==0.2.1 numpy==2.4.6 2>/dev/null
cd "$folder"
venv/bin/python - <<'PYTHON'
import struct

import numpy as np
from adcpreader.rdi_reader import PD0
from trdi_adcp_readers.readers import read_PD0_bytes, read_PD0_file

CELLS, PINGS, RATE_HZ = 5, 8, 4


def ping(number):
    """Return an ensemble: leaders, velocities (mm/s), correlations, echoes and percentages of four beams."""
    second, hundredths = divmod(number * 100 // RATE_HZ, 100)
    time = (26, 5, 4, 10, 0, second, hundredths)
    fixed = bytearray(59)
    struct.pack_into("<HBBHBBBBHHH", fixed, 0, 0x0000, 56, 4, 0x41CA, 0, 9, 4, CELLS, 1, 100, 44)
    fixed[25] = 0x1F
    struct.pack_into("<HH", fixed, 32, 150, 100)
    fixed[58] = 20
    variable = bytearray(65)
    struct.pack_into("<HH8B", variable, 0, 0x0080, number + 1, *time, 0)
    struct.pack_into("<HHHhhHh", variable, 14, 1500, 50, 27000, -150, 225, 35, 1250)
    struct.pack_into("<8B", variable, 57, 20, *time)
    velocities = np.full((CELLS, 4), 100 * number, "<i2")
    blocks = [bytes(fixed), bytes(variable), struct.pack("<H", 0x0100) + velocities.tobytes()]
    blocks += [struct.pack("<H", kind) + bytes([90]) * 4 * CELLS for kind in (0x0200, 0x0300, 0x0400)]
    starts = 6 + 2 * len(blocks) + np.cumsum([0, *map(len, blocks)])
    size = starts[-1] + 2
    head = struct.pack(f"<BBHBB{len(blocks)}H", 0x7F, 0x7F, size, 0, len(blocks), *starts[:-1])
    data = head + b"".join(blocks) + bytes(2)
    return data + struct.pack("<H", sum(data) & 0xFFFF)


pings = [ping(number) for number in range(PINGS)]
with open("dvl.pd0", "wb") as file:
    file.write(b"".join(pings))
start = np.datetime64("2026-05-04T10:00:00", "us")
alone = [read_PD0_bytes(bytearray(data)) for data in pings]
trdi_s = [float((np.datetime64(each["timestamp"], "us") - start) / np.timedelta64(1, "s")) for each in alone]
of_file = read_PD0_file("dvl.pd0")
ensembles = list(PD0().ensemble_generator("dvl.pd0"))
reader_s = [ensemble["variable_leader"]["Timestamp"] - start.astype(int) / 1e6 for ensemble in ensembles]
print("trdi-adcp-readers:", trdi_s, "and of the file:", of_file["timestamp"])
print("adcpreader:       ", np.round(reader_s, 6).tolist())
assert [each["velocity"]["data"][0][0] for each in alone] == [100 * number for number in range(PINGS)]
assert np.allclose([ensemble["velocity"]["Velocity1"][0] for ensemble in ensembles], [number / 10 for number in range(PINGS)])
assert trdi_s == [second + fraction for second in (0, 1) for fraction in (0, 25e-6, 50e-6, 75e-6)]
assert np.allclose(reader_s, [second + fraction for second in (0, 1) for fraction in (0, 0.025, 0.05, 0.075)], atol=1e-6)
assert of_file["variable_leader"]["ensemble_number"] == 1 and of_file["timestamp"].second == 0
PYTHON
