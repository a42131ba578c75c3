#!/usr/bin/env bash
# Pictures become an MP4 whose times are those of their messages, to the nanosecond: the time base of the stream is 1/1,000,000,000, which PyAV
# and the format take. The camera pauses for some seconds. When is the picture after the pause?
# Guess: at its time, to the nanosecond, or an error where the format has no room. Seen with PyAV 18.1.0 (FFmpeg) on 2026-11-29:
# - after a pause of 2.1 s, right; after one of 2.2 s or more (2^31 ns) at the time of the picture before it, as is everything that follows:
#   the film ends there, and all later pictures lie within some nanoseconds, without a word. MOV likewise. In microseconds all is well
# - Matroska has milliseconds whatever time base was asked for: 33,366,700 ns is 33 ms
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check av==18.1.0 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
from fractions import Fraction

import av
import numpy as np


def read_times(name, per_second, times_ns):
    """Write a picture at each time into a file, with that time base, and return the times (s) that are read from it."""
    with av.open(name, "w") as container:
        stream = container.add_stream("libx264", rate=30, options={"bf": "0"})
        stream.width = stream.height = 64
        stream.time_base = stream.codec_context.time_base = Fraction(1, per_second)
        for number, time_ns in enumerate(times_ns):
            frame = av.VideoFrame.from_ndarray(np.full((64, 64, 3), 40 * number, "uint8"), format="rgb24")
            frame.pts, frame.time_base = time_ns * per_second // 10**9, stream.time_base
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    with av.open(name) as container:
        return [round(float(frame.pts * frame.time_base), 6) for frame in container.decode(video=0)]


def paused(pause_ns):
    return [0, 100_000_000, 100_000_000 + pause_ns, 200_000_000 + pause_ns]


for name, per_second, pause_ns, seen in (
    ("film.mp4", 10**9, 2_100_000_000, [0, 0.1, 2.2, 2.3]),
    ("film.mp4", 10**9, 2_200_000_000, [0, 0.1, 0.1, 0.1]),
    ("film.mov", 10**9, 60_000_000_000, [0, 0.1, 0.1, 0.1]),
    ("film.mp4", 10**6, 60_000_000_000, [0, 0.1, 60.1, 60.2]),
):
    times = read_times(name, per_second, paused(pause_ns))
    print(f"{name}, 1/{per_second}, a pause of {pause_ns * 1e-9:.1f} s: {times}")
    assert times == seen
times = read_times("film.mkv", 10**9, [0, 33_366_700, 66_733_400])
print(f"film.mkv: {times}")
assert times == [0, 0.033, 0.067]
PYTHON
