#!/usr/bin/env bash
# At which averaging times does allantools give the Allan deviation of a gyroscope, if one names them?
# Guess: at those, one value each, or an error. Seen with allantools 2024.6 on 2026-11-28, for 10 s at 100 Hz: the list that comes back is
# shorter. 0.014 s is 0.01 s, 0.016 s is 0.02 s (whole samples, of which equal ones are one), and 8 s and 20 s are left out, as too few
# averages remain: four values for seven times, by which a plot against the times asked for is wrong or fails.
# And one NaN, as for a lost message, makes the deviation NaN at every time, also where it is in one of a thousand averages.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check AllanTools==2024.6 numpy==2.4.6 scipy==1.17.1
cd "$folder"
venv/bin/python - <<'PYTHON'
import allantools
import numpy as np

rates = np.random.default_rng(0).normal(size=1000)
asked_s = [0.01, 0.014, 0.016, 0.1, 4.0, 8.0, 20.0]
times_s, deviations, _, counts = allantools.oadev(rates, rate=100, data_type="freq", taus=asked_s)
print("asked:", asked_s, "got:", times_s.tolist(), deviations.round(3).tolist(), counts.tolist())
rates[10] = np.nan
_, lost, _, _ = allantools.oadev(rates, rate=100, data_type="freq", taus=[0.1, 1.0])
print("one lost message:", lost.tolist())
same = np.allclose(times_s, [0.01, 0.02, 0.1, 4.0]) if len(times_s) == 4 else False
raise SystemExit(0 if same and np.isnan(lost).all() else "no longer so")
PYTHON
