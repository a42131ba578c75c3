#!/usr/bin/env bash
# Events of 30 s are a text file, "t x y p": with t in seconds, as in the data sets of Zurich (0.003811000), or in microseconds, as Prophesee's tools have it.
# Guess: each reader finds out by the decimals, asks, or refuses the other. Seen on 2026-11-30, none says a word:
#   evlib 0.13.2     seconds, always: microseconds become 347 days, and microseconds since 1970 all the same time, the largest there is. Of HDF5 it takes
#                    microseconds, always: a recording of a second in seconds is at 0
#   evlab 0.3.0a1, evutils 0.3.18   microseconds, always: the 30 s are 29 microseconds, with as many events in each of the 30 times as there were in a second
# So a file that evlab or evutils has saved as text is a million times as long for evlib.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check evlib==0.13.2 evlab==0.3.0a1 evutils==0.3.18 polars==2.1.0 h5py==3.16.0 numpy==2.4.6 2>/dev/null
cd "$folder"
cat > read.py <<'PYTHON'
import evlab.formats
import evlib
import h5py
import numpy as np
from evutils.io import EventReader

SPAN_S, COUNT = 30, 3000
times_s = np.round(np.sort(np.random.default_rng(0).uniform(0, SPAN_S, COUNT)), 6)


def text(name, times, digits):
    """Write events at `times` as text, apart by blanks, or commas if the name ends so."""
    gap = "," if name.endswith(".csv") else " "
    with open(name, "w") as file:
        file.writelines(gap.join((f"{time:.{digits}f}", "3", "4", "1")) + "\n" for time in times)
    return name


def by_evlib(name):
    return evlib.load_events(name).collect()["t"].dt.total_microseconds().to_numpy()


def by_evutils(name):
    return np.concatenate([np.asarray(chunk.t) for chunk in EventReader(name)])


seconds, micros = text("seconds.txt", times_s, 6), text("micros.txt", times_s * 1e6, 0)
commas = text("seconds.csv", times_s, 6)
text("micros.csv", times_s * 1e6, 0)
absolute = text("absolute.txt", 1_700_000_000_000_000 + times_s * 1e6, 0)
expected_us = np.round(times_s * 1e6).astype(np.int64)

for name in (seconds, micros, absolute):
    print(f"evlib, {name}: {by_evlib(name)[-1] / 1e6:.6g} s")
assert np.abs(by_evlib(seconds) - expected_us).max() <= 1
assert np.array_equal(by_evlib(micros), expected_us * 1_000_000)
assert set(by_evlib(absolute)) == {np.iinfo(np.int64).max}

for reader, read, in_seconds, in_micros in (
    ("evlab", lambda name: evlab.formats.load(name).events["t"], seconds, micros),
    ("evutils", by_evutils, commas, "micros.csv"),
):
    print(f"{reader}, seconds: {read(in_seconds)[-1]} us, {len(set(read(in_seconds)))} different times")
    assert np.array_equal(read(in_seconds), times_s.astype(np.int64))
    assert np.array_equal(read(in_micros), expected_us)

evlab.formats.save(evlab.formats.load(micros), "saved.txt")
assert np.array_equal(by_evlib("saved.txt"), expected_us * 1_000_000)

for name, times in (("seconds.h5", times_s / SPAN_S), ("micros.h5", expected_us)):
    with h5py.File(name, "w") as file:
        group = file.create_group("events")
        group["t"], group["p"] = times, np.ones(COUNT, np.uint8)
        group["x"] = group["y"] = np.full(COUNT, 3, np.uint16)
print(f"evlib, HDF5: a second in seconds ends at {by_evlib('seconds.h5')[-1]} us")
assert not by_evlib("seconds.h5").any()
assert np.array_equal(by_evlib("micros.h5"), expected_us)
PYTHON
venv/bin/python -W error::UserWarning read.py > read.txt 2> said.txt
cat read.txt
if grep -iE 'second|unit|time' said.txt; then exit 1; fi
