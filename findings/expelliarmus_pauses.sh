#!/usr/bin/env bash
# Events are cut out of a recording, one every 20 ms, as a small region gives, and saved by expelliarmus as EVT3; or a whole shift as EVT2; or
# with times since 1970. What times come back? Guess: those that were saved, in microseconds, or an error where a format has no room.
# Seen with expelliarmus 1.1.12 on 2026-11-29, by its own reader:
# - evt3: of every pause the multiples of 4096 microseconds are lost. The 40 s of 2000 events are 7.2 s, and the events themselves are right.
#   The file has no EVT_TIME_HIGH but the first: the reader makes up for one as often as the lower 12 bits go back.
# - evt2: from 71.6 minutes on, times begin anew at 0. The format has 34 bits for them, 4.8 hours; the file has 32.
# - dat: 2023 is 405 s; evt2 and evt3 likewise lose what is above their bits
# One warning is printed, for times that go back, and none for pauses.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check expelliarmus==1.1.12 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import numpy as np
from expelliarmus import Wizard


def saved_and_read(encoding, times_us):
    """Return the times after a way through a file."""
    events = np.zeros(len(times_us), [("t", "i8"), ("x", "i2"), ("y", "i2"), ("p", "u1")])
    events["t"], events["x"] = times_us, np.arange(len(times_us)) % 640
    wizard, file = Wizard(encoding=encoding), "a.dat" if encoding == "dat" else "a.raw"
    wizard.save(file, events)
    read = wizard.read(file)
    assert np.array_equal(read["x"], events["x"])
    return read["t"]


sparse_us, dense_us = np.arange(2000) * 20_000, np.arange(20_000) * 2_000
sparse = saved_and_read("evt3", sparse_us)
print(f"evt3: {sparse_us[-1] / 1e6} s become {sparse[-1] / 1e6} s; evt2 and dat: the same {saved_and_read('evt2', sparse_us)[-1] / 1e6} s")
assert np.array_equal(np.diff(sparse), np.diff(sparse_us) % 4096)
for encoding, times_us in (("evt2", sparse_us), ("dat", sparse_us), ("evt3", dense_us)):
    assert np.array_equal(saved_and_read(encoding, times_us), times_us)

shift_us = np.array([0, 4_000_000_000, 5_000_000_000])
shift = saved_and_read("evt2", shift_us)
print(f"evt2: {shift_us[-1] / 1e6} s become {shift[-1] / 1e6} s")
assert shift.tolist() == [0, 4_000_000_000, 5_000_000_000 - 2**32]

(absolute,) = saved_and_read("dat", np.array([1_700_000_000_000_000]))
print(f"dat: 1700000000 s become {absolute / 1e6} s")
assert absolute == 1_700_000_000_000_000 % 2**32
PYTHON
