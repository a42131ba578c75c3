#!/usr/bin/env bash
# A log of LCM holds ten seconds at 100 Hz. The last five are wanted: `log.seek_to_timestamp(...)`, then `for event in log`.
# Guess: events from 5 s on, or a few before, as the function says "approximately". Seen with lcm 1.5.3 on 2026-11-29, without a word:
# - all thousand, from 0 s on: `for` goes back to the beginning, and so does each `iter(log)`, after `seek` likewise; to read on from where
#   one is, only `read_next_event` will do
# - of a log whose times go back once, as several processes write it, a seek to 0.2 s finds the event of 0.3 s: those of 0.2 and 0.15 s,
#   which are in the file before it, are passed over
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check lcm==1.5.3
cd "$folder"
venv/bin/python - <<'PYTHON'
import lcm

START_US = 1_700_000_000_000_000


def write(name, times_s):
    log = lcm.EventLog(name, "w")
    for time_s in times_s:
        log.write_event(START_US + round(time_s * 1e6), "IMU", bytes(8))
    log.close()
    return lcm.EventLog(name, "r")


def seconds(event):
    return (event.timestamp - START_US) / 1e6


log = write("drive.lcm", [number / 100 for number in range(1000)])
log.seek_to_timestamp(START_US + 5_000_000)
looped = [seconds(event) for event in log]
log.seek_to_timestamp(START_US + 5_000_000)
read = seconds(log.read_next_event())
again = seconds(next(iter(log)))
print(f"`for`: {len(looped)} events from {looped[0]} s; read_next_event: {read} s, then iter(): {again} s")
assert len(looped) == 1000 and looped[0] == 0
assert read == 5 and again == 0

log = write("back.lcm", [0.1, 0.2, 0.15, 0.3])
log.seek_to_timestamp(START_US + 200_000)
found = seconds(log.read_next_event())
print(f"seek to 0.2 s in a log of 0.1, 0.2, 0.15 and 0.3 s: {found} s")
assert found == 0.3
PYTHON
