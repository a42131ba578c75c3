#!/usr/bin/env bash
# A table (CSV) of a wristband at 2000 Hz has two muscles, `biceps_emg` and `flexor_emg`, and no column of times, as the rate is given (`sample_frequency=2000`). Another one has `flexor_emg`, `sensor_temp` in
# degrees and the time `t` in seconds, and no rate is given. Both are opened with biosigio. Guess: both muscles in the first; in the second 2000 Hz by `t`.
# Seen with biosigio 1.2.13 and emgio 0.6.0 (as it was called before) on 2026-11-30, without a word:
# - ONE muscle in the first: a column is one of times if there is a letter "s" in its name, and the first such one is no channel, also where the rate is given. So with `wrist`, `sensor 1`, `pressure`
# - in the second it is `sensor_temp`, and the rate is that of degrees: 1000 Hz, as it is set up, where it cools, and where it warms as many Hz as there are samples to a degree, 400 for 5 degrees
#   in the second; `t` is a channel. A name without that letter (`bicep_emg`, `temp`) keeps its channel
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check biosigio==1.2.13 emgio==0.6.0 pyxdf==1.17.5 numpy==2.4.6 pandas==2.3.3 2>/dev/null
cat > table.py <<'PYTHON'
import biosigio
import emgio
import numpy as np
import pandas as pd

RATE_HZ = 2000
random = np.random.default_rng(0)
muscles = random.normal(0, 0.1, (2, RATE_HZ))
times_s = np.arange(RATE_HZ) / RATE_HZ


def opened(package, columns, **options):
    """Return names and rates of the channels of a table of these columns."""
    pd.DataFrame(columns).to_csv("take.csv", index=False)
    recording = package.Recording.from_file("take.csv", importer="csv", **options)
    channels = {name: round(float(channel["sample_frequency"]), 1) for name, channel in recording.channels.items()}
    print(f"{package.__name__}: of {list(columns)}, {options}: {channels}")
    return channels


for package in (biosigio, emgio):
    assert opened(package, {"biceps_emg": muscles[0], "flexor_emg": muscles[1]}, sample_frequency=RATE_HZ) == {"flexor_emg": RATE_HZ}
    assert opened(package, {"bicep_emg": muscles[0], "flexor_emg": muscles[1]}, sample_frequency=RATE_HZ) == {"bicep_emg": RATE_HZ, "flexor_emg": RATE_HZ}
    for change, rate_hz in ((5.0, 400.0), (0.1, 20_000.0), (-5.0, 1000.0)):
        got = opened(package, {"flexor_emg": muscles[1], "sensor_temp": 30 + change * times_s, "t": times_s})
        assert got == {"flexor_emg": rate_hz, "t": rate_hz}
PYTHON
venv/bin/python -W error table.py > said.txt 2>&1 || { tail -8 said.txt; exit 1; }
if grep -i warn said.txt; then exit 1; fi
grep -v "^\[INFO\] Reminder\|^  \(emg\|rec\)\.set\|^Example" said.txt
