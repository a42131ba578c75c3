#!/usr/bin/env bash
# Which times of lidar points does rko_lio understand by itself?
# Guess: it refuses what it cannot tell. Seen with rko_lio 0.4.0 on 2026-11-28, for a revolution of 0.1 s from the header on:
#   absolute seconds, relative seconds or nanoseconds       right
#   relative microseconds, relative milliseconds            a revolution of 0.0001 s and of 100 s, without a word
#   absolute seconds of which one is 0 (an empty return)    all other points 1.75 s late, without a word
#   absolute microseconds; seconds since the lidar started  refused, with advice
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check rko_lio==0.4.0 numpy==2.4.6
"$folder/venv/bin/python" - <<'PYTHON'
import numpy as np
from rko_lio import rko_lio_pybind as rko

HEADER_NS = 1_750_000_000_000_000_000
relative_s = np.linspace(0.0, 0.1, 1001)
absolute_s = HEADER_NS / 1e9 + relative_s
one_zero = absolute_s.copy()
one_zero[300] = 0.0


def after_header_s(times):
    """First, middle and last time of the points, in seconds after the header."""
    try:
        _, _, ns = rko._process_timestamps(
            rko._VectorDouble(times), HEADER_NS, rko._TimestampProcessingConfig()
        )
    except rko.InputError:
        return None
    return [round((int(np.asarray(ns)[i]) - HEADER_NS) / 1e9, 5) for i in (0, 500, 1000)]


cases = {
    "absolute seconds": (absolute_s, [0.0, 0.05, 0.1]),
    "relative seconds": (relative_s, [0.0, 0.05, 0.1]),
    "relative nanoseconds": (relative_s * 1e9, [0.0, 0.05, 0.1]),
    "relative microseconds": (relative_s * 1e6, [0.0, 0.00005, 0.0001]),
    "relative milliseconds": (relative_s * 1e3, [0.0, 50.0, 100.0]),
    "absolute seconds, one zero": (one_zero, [1.75, 1.75, 1.75]),
    "absolute microseconds": (absolute_s * 1e6, None),
    "seconds since the lidar started": (3298.4 + relative_s, None),
}
changed = []
for name, (times, seen) in cases.items():
    got = after_header_s(times)
    print(f"{name}: {got or 'refused'}")
    if (got is None) != (seen is None) or (seen and not np.allclose(got, seen, atol=1e-3 if seen[0] else 2e-5)):
        changed.append(name)
raise SystemExit(f"no longer so: {', '.join(changed)}" if changed else 0)
PYTHON
