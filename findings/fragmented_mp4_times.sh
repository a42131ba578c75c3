#!/usr/bin/env bash
# A recorder writes the pictures of a camera to an MP4 with their times, by x264 as it is set up: ten a second by day, one a second by night. So that a crash leaves what was
# written until then, the MP4 is fragmented (`movflags`). When is each picture? Guess: at its time, as without fragments: how a file is laid out is not when
# a picture is shown.
# Seen with PyAV 18.1.0 (FFmpeg in its wheel) on 2026-11-30, without a word: all pictures are late by two of the camera's, 0.2 s by day, 2 s by night, with
# `frag_keyframe`, alone or with `empty_moov`. What takes the delay of B-frames back, an edit list, is written before it is known; so no reader can tell, and a
# camera without B-frames, or with another codec, is not late. `negative_cts_offsets`, which is to do without an edit list, changes nothing here.
# `delay_moov` is right to the millisecond, and so are B-frames that are switched off, and a file without fragments
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check av==18.1.0 numpy==2.4.6
venv/bin/python - <<'PYTHON'
from fractions import Fraction

import av
import numpy as np

PICTURES, MS = 20, Fraction(1, 1000)
LATE_PICTURES = {
    "": 0,
    "faststart": 0,
    "frag_keyframe": 2,
    "frag_keyframe+empty_moov": 2,
    "frag_keyframe+empty_moov+default_base_moof": 2,
    "frag_keyframe+empty_moov+negative_cts_offsets": 2,
    "frag_keyframe+delay_moov": 0,
}


def write(flags, step_ms, options):
    with av.open("camera.mp4", "w", options={"movflags": flags} if flags else {}) as container:
        stream = container.add_stream("libx264", rate=30, options=options)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        stream.time_base = stream.codec_context.time_base = MS
        for number in range(PICTURES):
            frame = av.VideoFrame.from_ndarray(np.full((48, 64, 3), 8 * number, np.uint8), format="rgb24")
            frame.pts, frame.time_base = number * step_ms, MS
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


def late_ms(step_ms):
    """Return by how much each picture is late, which is the same for all."""
    with av.open("camera.mp4") as container:
        times = [round(frame.time * 1000) for frame in container.decode(video=0)]
    (late,) = {time - number * step_ms for number, time in enumerate(times)}
    assert len(times) == PICTURES
    return late


for flags, pictures in LATE_PICTURES.items():
    found = []
    for step_ms in (100, 1000):
        write(flags, step_ms, {})
        found.append(late_ms(step_ms))
        write(flags, step_ms, {"bf": "0"})
        assert late_ms(step_ms) == 0, flags
    print(f"{flags or 'no flags'}: late by {found} ms, at ten pictures a second and at one")
    assert found == [pictures * 100, pictures * 1000], flags
PYTHON
