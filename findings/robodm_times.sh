#!/usr/bin/env bash
# A robot's steps come every 2 ms; each has four values of one time, which go into a trajectory of robodm with `add_by_dict` and that time.
# Which times does the file hold? Guess: those that were given, one for the four of a step, as its documentation assumes.
# Seen with robodm 0.1.0 and PyAV 18.1.0 on 2026-11-29, as it is set up, and only told to those who log at DEBUG: the four are 1, 2, 3 and 4 ms
# late. Times must increase from VALUE to value, of whatever feature, so each equal one is moved 1 ms behind the last; a step of four takes
# 5 ms then, and time runs two and a half times too slowly: the 500th step, given at 1.1 s, is at 2.6 s. Steps of 100 ms do not run away, but
# an action is some ms behind its observation. A message that comes 50 ms late, by its stamp, is moved behind the newest.
# `enforce_monotonic=False` keeps all times.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check av==18.1.0 h5py==3.16.0 numpy==2.4.6
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check --no-deps robodm==0.1.0
cd "$folder"
venv/bin/python - <<'PYTHON'
from pathlib import Path

import av
import numpy as np
from robodm import Trajectory

NAMES = ("left", "right", "effort", "action")


def times_ms(path, add, **options):
    """Return the times of each feature in a trajectory that `add` fills."""
    trajectory = Trajectory(path=str(Path(path).resolve()), mode="w", **options)
    add(trajectory)
    trajectory.close(compact=False)
    found = {}
    with av.open(path) as container:
        for packet in container.demux():
            if packet.pts is not None:
                name = packet.stream.metadata["FEATURE_NAME"]
                found.setdefault(name, []).append(round(packet.pts * packet.time_base * 1000))
    return found


def steps(apart_ms):
    def add(trajectory):
        for number in range(501):
            values = {name: np.array([float(number)], np.float32) for name in NAMES}
            trajectory.add_by_dict(values, timestamp=100 + apart_ms * number, time_unit="ms")

    return add


def late(trajectory):
    for name, time_ms in (("camera", 100), ("camera", 200), ("joints", 150), ("camera", 210)):
        trajectory.add(name, np.array([0.0], np.float32), timestamp=time_ms, time_unit="ms")


fast, slow = times_ms("fast.vla", steps(2)), times_ms("slow.vla", steps(100))
kept = times_ms("kept.vla", steps(2), enforce_monotonic=False)
moved = times_ms("late.vla", late)
for name, found in (("2 ms", fast), ("100 ms", slow), ("2 ms, not enforced", kept)):
    print(name, "apart:", {feature: [*times[:3], times[500]] for feature, times in found.items()})
print("late:", moved)
for place, name in enumerate(NAMES, start=1):
    assert fast[name] == [100 + 5 * number + place for number in range(501)]
    assert slow[name] == [100 + 100 * number + place for number in range(501)]
    assert kept[name] == [100 + 2 * number for number in range(501)]
assert moved == {"camera": [100, 200, 210], "joints": [201]}
PYTHON
