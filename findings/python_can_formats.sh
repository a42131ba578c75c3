#!/usr/bin/env bash
# Three frames of three CAN buses (channels 0, 1, 2), the last one sent by the logger itself, are written with each format of python-can, and
# read with it. The stamps are 1700000000.123456 s and on. What comes back?
# Guess: the stamps, and the channels; formats of text may round. Seen with python-can 4.6.1 on 2026-11-29:
#   blf       the same
#   mf4       the same only in the same time zone: what was written in Berlin is an hour late for a reader in London
#   asc       0.0 s and on; with `relative_timestamp=False` 456 microseconds early, as the start is cut to milliseconds, and late like mf4
#   trc       the channels are 1, 2, 3
#   log       the channels are "can0", "can1", "can2", text
#   csv, db   no channel at all, and nothing sent, all received: three buses are one
# None of them warns, so it depends on the suffix of the file which bus a frame was on, and when.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check python-can==4.6.1 asammdf==8.8.28 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import os
import time

import can

START_S = 1_700_000_000.123456


def clock(zone):
    os.environ["TZ"] = zone
    time.tzset()


def frames(suffix, **options):
    """Return channels, directions and the first time of what is read."""
    found = list(can.LogReader(f"drive.{suffix}", **options))
    return [one.channel for one in found], [one.is_rx for one in found], round(found[0].timestamp, 6)


clock("CET-1")  # as in Berlin in winter
for suffix in ("asc", "blf", "mf4", "trc", "log", "csv", "db"):
    with can.Logger(f"drive.{suffix}") as logger:
        for number in range(3):
            logger(can.Message(timestamp=START_S + number / 10, arbitration_id=256, data=[number], is_rx=number < 2, channel=number))
clock("UTC0")
whole, directions = [0, 1, 2], [True, True, False]
expected = {
    "blf": (whole, directions, START_S),
    "mf4": (whole, directions, START_S + 3600),
    "asc": (whole, directions, 0.0),
    "trc": ([1, 2, 3], directions, START_S),
    "log": (["can0", "can1", "can2"], directions, START_S),
    "csv": ([None] * 3, [True] * 3, START_S),
    "db": ([None] * 3, [True] * 3, START_S),
}
for suffix, what in expected.items():
    got = frames(suffix)
    print(f"{suffix}: channels {got[0]}, received {got[1]}, first at {got[2]}")
    assert got == what, what
_, _, absolute = frames("asc", relative_timestamp=False)
print(f"asc, absolute: {absolute} in London")
assert absolute == 1_700_000_000.123 + 3600
clock("CET-1")
assert frames("mf4")[2] == START_S
PYTHON
