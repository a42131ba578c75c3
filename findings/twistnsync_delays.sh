#!/usr/bin/env bash
# Two IMUs on one rig, of a lidar and of a camera, are moved by hand for a minute; the delay between their clocks is found from their gyroscopes with twistnsync, "time synchronization with microseconds
# accuracy". Here the second one is late by 100 to 119 ms, without noise, both with 100 samples a second. Guess: the delay, to some tens of microseconds; at worst to a millisecond.
# Seen with twistnsync 0.3.0 on 2026-11-30, without a word: about every other delay is right to 1 ms (at the ends of the minute is what the other IMU has not seen), and about every other is 10 ms
# too long, one sample: the peak of the correlation is looked for between its highest value and the one before, and then counted from the highest. With 200 samples a second it
# is 5 ms. So it is as often wrong as the delay is in the one half of a sample
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check twistnsync==0.3.0 numpy==2.4.6 scipy==1.17.1 2>/dev/null
cat > delays.py <<'PYTHON'
import numpy as np
from scipy.interpolate import CubicSpline
from twistnsync import TimeSync

random = np.random.default_rng(0)
seconds = np.arange(-5, 70, 0.002)
smooth = np.exp(-0.5 * (np.arange(-400, 401) * 0.002 / 0.15) ** 2)
turns = np.stack([np.convolve(random.normal(size=len(seconds)), smooth / smooth.sum(), "same") for _ in range(3)], axis=1)
angular_velocity = CubicSpline(seconds, 20 * turns)


def found_s(delay_s, rate_hz):
    times_s = np.arange(0, 60, 1 / rate_hz)
    sync = TimeSync(angular_velocity(times_s), angular_velocity(times_s - delay_s), times_s, times_s)
    sync.resample()
    sync.obtain_delay()
    return sync.time_delay


delays_s = np.arange(100, 120) / 1000
for rate_hz in (100, 200):
    errors_ms = np.array([1000 * (found_s(delay_s, rate_hz) - delay_s) for delay_s in delays_s])
    late = errors_ms > 2
    print(f"{rate_hz} samples a second: errors in ms", errors_ms.round(1).tolist())
    print(f"  {late.sum()} of {len(late)} late by {np.mean(errors_ms[late]) - np.mean(errors_ms[~late]):.2f} ms against the others, whose errors are up to {abs(errors_ms[~late]).max():.2f} ms")
    assert 7 <= late.sum() <= 13 and abs(errors_ms[~late]).max() < 1
    assert np.allclose(errors_ms[late] - 1000 / rate_hz, errors_ms[~late].mean(), atol=0.05)
PYTHON
venv/bin/python delays.py > said.txt 2>&1 || { tail -8 said.txt; exit 1; }
if grep -i warn said.txt; then exit 1; fi
cat said.txt
