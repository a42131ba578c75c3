#!/usr/bin/env bash
# Joint angles of an arm, a minute long, are brought to the rate of its cameras with the interpolation of airdc, which collects robots' demonstrations
# (`Interpolate.linear_interpolate`, `way_points_interpolate`). Guess: 1801 rows at 30 Hz, 3601 at 60 Hz, a thirtieth and a sixtieth of a second apart; where nothing is
# to be interpolated (`no_interpolate`), the value that was last measured. Seen with airdc 0.7.0 on 2026-11-30, without a word:
# - 1820 rows, 33 ms apart, and 3751, 16 ms apart, as steps are whole milliseconds, cut off; the last step is 6 ms. Row by row beside pictures, angles are 0.6 s
#   behind after a minute at 30 Hz, and 2.4 s at 60 Hz; a way of a minute, played at 60 Hz, takes 62.5 s. At 10, 50 and 250 Hz all is right
# - `no_interpolate` gives the NEXT value: a gripper that closes at 1 s is closed from the row after 0 s on
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check airdc==0.7.0 PyYAML==6.0.3 scipy==1.17.1 matplotlib==3.11.2 numpy==2.4.6 2>/dev/null
cat > ticks.py <<'PYTHON'
import numpy as np
from airdc.common.utils.interpolate import Interpolate

MINUTE_S = np.array([0.0, 60.0])
rows = {}
for hz in (10, 30, 50, 60, 250):
    times_s, angles = Interpolate.linear_interpolate(MINUTE_S.copy(), MINUTE_S.copy(), 1 / hz)  # an angle of 1 rad after a second
    at_the_end = angles[min(60 * hz, len(angles) - 1)]
    played_s = len(Interpolate.way_points_interpolate(np.array([[0.0], [60.0]]), MINUTE_S.copy(), hz)) / hz
    rows[hz] = len(times_s)
    print(f"{hz} Hz: {len(times_s)} rows, {60 * hz + 1} are right; {times_s[1] * 1000:.0f} ms apart; row {60 * hz} is of {at_the_end:.2f} s; played in {played_s:.1f} s")
assert rows == {10: 601, 30: 1820, 50: 3001, 60: 3751, 250: 15001}
_, angles = Interpolate.linear_interpolate(MINUTE_S.copy(), MINUTE_S.copy(), 1 / 60)
assert np.isclose(angles[3600], 57.6) and np.isclose(3600 / 60 - angles[3600], 2.4)

times_s, closed = Interpolate.no_interpolate(np.array([0.0, 1.0, 1.0]), np.array([0.0, 1.0, 2.0]), 0.25)
print("closed at", [float(at) for at, value in zip(times_s, closed) if value], "s, of 0 at 0 s and 1 from 1 s on")
assert closed[0] == closed[1] == 1.0
PYTHON
venv/bin/python ticks.py > ticks.txt 2>&1 || { cat ticks.txt; exit 1; }
cat ticks.txt
if grep -i warn ticks.txt; then exit 1; fi
