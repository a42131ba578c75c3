#!/usr/bin/env bash
# A measurement (MF4) of ten seconds, speed and gear once a second, is cut at 4.2 s into two with asammdf, and the two are joined again.
# What comes back? Guess: the same samples at the same times, each once, as both parts know when the measurement began.
# Seen with asammdf 8.8.28 on 2026-11-29, as it is set up, without a word:
# - each part has samples that nobody measured, at the cut: a speed of 42 between 40 and 50, and a gear
# - joined, everything behind the cut is 0.8 s late: what was measured at 6 s is at 6.8 s. The second part begins at the time where the first
#   ends, so it is taken for one that starts anew, and is put a mean period behind; with `sync=False` likewise
# `cut(…, include_ends=False)` makes nothing up, and parts that it made are joined at their times.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check asammdf==8.8.28 numpy==2.4.6
cd "$folder"
venv/bin/python -W ignore - <<'PYTHON'
import numpy as np
from asammdf import MDF, Signal

seconds = np.arange(11.0)
with MDF() as measurement:
    measurement.append([Signal(10 * seconds, seconds, name="speed"), Signal(np.arange(11, dtype="uint8"), seconds, name="gear")])
    measurement.save("drive.mf4", overwrite=True)


def joined(**how):
    """Cut the measurement at 4.2 s, join the parts, and return times and samples of the speed, and the gear at the cut."""
    with MDF("drive.mf4") as whole:
        first, second = whole.cut(stop=4.2, **how), whole.cut(start=4.2, **how)
    both = [MDF.concatenate([first, second], sync=sync).get("speed") for sync in (True, False)]
    assert np.array_equal(both[0].timestamps, both[1].timestamps)
    return both[0].timestamps.round(6).tolist(), both[0].samples.tolist(), first.get("gear")


times, speeds, gear = joined()
print(*(f"{time_s} s: {speed}" for time_s, speed in zip(times, speeds)), sep=", ")
assert times == [0, 1, 2, 3, 4, 4.2, 5, 5.8, 6.8, 7.8, 8.8, 9.8, 10.8]
assert speeds == [0, 10, 20, 30, 40, 42, 42, 50, 60, 70, 80, 90, 100]
assert gear.timestamps[-1] == 4.2
times, speeds, _ = joined(include_ends=False)
assert times == seconds.tolist() and speeds == (10 * seconds).tolist()
PYTHON
