#!/usr/bin/env bash
# Events of a Prophesee camera are a .dat file: 32 bits of microseconds each, so times begin anew after 71.6 minutes, and of one readout an event may stand a microsecond
# before its neighbour. Which times do readers give? Guess: a fall of an hour is a new round of the clock, one of a microsecond is none. Seen on 2026-12-01, without a word:
#   evlab 0.3.0a1   any fall is a new round: the microsecond, too. All that follows, the event itself included, is 71.6 minutes later: 3 ms of events last 4295 s,
#                   and windows of 50 ms for its monitors are 85,900, all but two of them empty
#   evio 0.1.0      no fall is: after 71.6 minutes times begin anew at 0. Its help has times sorted by every reader, and `time_window` searches by halves: of the half second
#                   after the turn it returns 15 events for 5, ten of them from before it, and of the half second before, none for 5
# A file of a shorter recording whose times only rise is read alike by both.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check evlab==0.3.0a1 evio==0.1.0 numpy==2.4.6 2>/dev/null
cd "$folder"
venv/bin/python - <<'PYTHON'
import evio
import evlab.features
import evlab.formats
import numpy as np

ROUND_US = 1 << 32


def write(name, times_us):
    events = np.zeros(len(times_us), [("t", "<u4"), ("payload", "<u4")])
    events["t"] = np.asarray(times_us, np.int64) % ROUND_US
    events["payload"] = 100 | 50 << 14 | 1 << 28
    header = b"% Data file containing CD events.\n% Version 2\n% Width 640\n% Height 480\n"
    with open(name, "wb") as file:
        file.write(header + bytes([12, 8]) + events.tobytes())


def times_of(name):
    return {"evlab": evlab.formats.load(name).events["t"].tolist(), "evio": evio.read(name)["t"].tolist()}


rising = [1000, 2000, 2500, 4000]
write("rising.dat", rising)
assert times_of("rising.dat") == {"evlab": rising, "evio": rising}

swapped = [1000, 2000, 1999, 4000]
write("swapped.dat", swapped)
seen = times_of("swapped.dat")
windows, _ = evlab.features.window_features(evlab.formats.load("swapped.dat"), 50_000)
print("one event a microsecond early:", seen, f"{len(windows)} windows, {np.count_nonzero(windows[:, 0])} with events")
assert seen == {"evlab": [1000, 2000, 1999 + ROUND_US, 4000 + ROUND_US], "evio": swapped}
assert len(windows) == ROUND_US // 50_000 + 1 == 85_900 and np.count_nonzero(windows[:, 0]) == 2

times_us = ROUND_US - 1_000_000 + 100_000 * np.arange(20)
write("long.dat", times_us)
seen = times_of("long.dat")
print("across the turn:", seen)
assert seen["evlab"] == times_us.tolist()
assert seen["evio"] == (times_us % ROUND_US).tolist()
turned = evio.read("long.dat")
after, before = evio.time_window(turned, 0, 500_000), evio.time_window(turned, ROUND_US - 500_000, ROUND_US)
print(f"evio, half a second after the turn: {len(after)} events, {np.count_nonzero(after['t'] > 500_000)} of them from before; half a second before: {len(before)}")
assert (len(after), np.count_nonzero(after["t"] > 500_000), len(before)) == (15, 10, 0)
PYTHON
