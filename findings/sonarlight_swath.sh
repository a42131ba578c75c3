#!/usr/bin/env bash
# A boat drives north at 60 degrees of latitude. Its Lowrance logs (.sl2) a side-scan sonar that looks 50 m to each side, and an echo sounder that is set to show
# 10 to 40 m, above a bottom at 20 m. The echoes' places are wanted, for a map or as labels: `Sonar` of sonarlight, which has them from `sidescan_xyz()`.
# Guess: a swath of 100 m; the bottom a third of the way down. Seen with sonarlight 0.1.7 on 2026-11-30, without a word:
# - the swath is 50 m wide: metres of the sonar are added to Mercator's, of which there are two to a metre at 60 degrees. So is `x`, and `longitude` of it
# - `bottom_intensity` is of two thirds of the way down, 30 m, and `water` holds ten metres of ground: `min_range` is taken off the span, and not off the depth
# - the last ping of the log is not there, of whichever channel it is
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check sonarlight==0.1.7 pandas==3.1.1 numpy==2.4.6 2>/dev/null
cd "$folder"
venv/bin/python - <<'PYTHON'
import math
import struct

import numpy as np
from sonarlight import Sonar

FEET, RADIUS_M, LATITUDE, PINGS, ECHOES = 3.2808399, 6356752.3142, math.radians(60), 20, 300
PRIMARY, SIDESCAN = 0, 5


def ping(at, number, channel, from_m, to_m, echoes):
    """Return a ping of an SL2 log that begins at byte `at`; of 144 bytes of header, those that are not named here are 0."""
    header = bytearray(144)
    y = RADIUS_M * math.log(math.tan(math.pi / 4 + LATITUDE / 2)) + number
    for place, form, value in (
        (0, "<I", at), (28, "<H", 144 + len(echoes)), (32, "<H", channel), (34, "<H", len(echoes)), (36, "<I", number),
        (40, "<f", from_m * FEET), (44, "<f", to_m * FEET), (60, "<I", 1_700_000_000), (64, "<f", 20 * FEET),
        (108, "<i", 0), (112, "<i", round(y)), (120, "<f", 0.0), (140, "<I", number * 100),
    ):  # fmt: skip
        struct.pack_into(form, header, place, value)
    return bytes(header) + bytes(echoes)


bottom = np.zeros(ECHOES, np.uint8)
bottom[ECHOES // 3] = 255
log = struct.pack("<4h", 2, 0, 3200, 0)
for number in range(PINGS):
    log += ping(len(log), number, PRIMARY, 10, 40, bottom)
    log += ping(len(log), number, SIDESCAN, -50, 50, np.arange(ECHOES, dtype=np.uint8))
with open("log.sl2", "wb") as file:
    file.write(log)

sonar = Sonar("log.sl2")
counts = {name: int((sonar.df["survey"] == name).sum()) for name in ("primary", "sidescan")}
print(f"pings: {PINGS} of each, read {counts}")
assert counts == {"primary": PINGS, "sidescan": PINGS - 1}

first = sonar.sidescan_xyz().iloc[:ECHOES]
metres = RADIUS_M * math.cos(LATITUDE) * np.radians(first["longitude"])
print(f"swath, by its longitudes: {metres.min():.1f} to {metres.max():.1f} m; y {np.ptp(first['y']):.1f}")
assert np.allclose((metres.min(), metres.max()), (-25, 25), atol=0.1)
assert np.isclose(first["latitude"].iloc[0], 60, atol=1e-4)

image, found = sonar.image("primary"), sonar.df.query("survey == 'primary'")["bottom_index"].iloc[0]
print(f"bottom: echo {image[0].argmax()}, looked for at {found}; intensity there {set(sonar.bottom_intensity('primary').tolist())}")
assert image[0].argmax() == 100 and found in (199, 200)
assert not sonar.bottom_intensity("primary").any() and sonar.water("primary", 200).max() > 100
PYTHON
