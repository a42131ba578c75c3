#!/usr/bin/env bash
# A recorded camera becomes an MP4 whose frames keep the times of their messages, as far apart as they came. How many does
# imageio-ffmpeg read? Guess: those that are in the file, one after the other.
# Seen with imageio-ffmpeg 0.8.1 (FFmpeg 9.0.2) on 2026-11-28: 31 for a file of 10 frames in a second. FFmpeg repeats the frame before
# wherever the next is late, on a grid of the highest rate it found, here 30 a second, without a word: frame i is not that of message i.
# `count_frames_and_secs` of the same library counts 10, and the `fps` of the metadata is 9.68, so neither says which time a frame has.
# `output_params=["-fps_mode", "passthrough"]` gives the 10.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check imageio-ffmpeg==0.8.1 av==18.1.0 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
from fractions import Fraction

import av
import imageio_ffmpeg
import numpy as np

TIMES_MS = (0, 33, 66, 300, 333, 366, 400, 900, 933, 1000)
MILLISECOND = Fraction(1, 1000)
with av.open("camera.mp4", "w") as container:
    stream = container.add_stream("libx264", rate=30, options={"crf": "5", "bf": "0"})
    stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
    stream.codec_context.time_base = MILLISECOND
    for number, time_ms in enumerate(TIMES_MS):
        frame = av.VideoFrame.from_ndarray(np.full((48, 64, 3), 20 * number + 20, np.uint8), format="rgb24")
        frame.pts, frame.time_base = time_ms, MILLISECOND
        container.mux(stream.encode(frame))
    container.mux(stream.encode(None))


def numbers(**options):
    frames = imageio_ffmpeg.read_frames("camera.mp4", **options)
    metadata = next(frames)
    return metadata["fps"], [round((np.frombuffer(frame, np.uint8).mean() - 20) / 20) for frame in frames]


with av.open("camera.mp4") as container:
    assert [round(frame.time * 1000) for frame in container.decode(video=0)] == list(TIMES_MS)
fps, read = numbers()
_, passed = numbers(output_params=["-fps_mode", "passthrough"])
count, seconds = imageio_ffmpeg.count_frames_and_secs("camera.mp4")
print(f"{len(read)} frames read: {read}\ncounted: {count} in {seconds} s; fps: {fps}; with passthrough: {passed}")
assert (len(read), count, fps) == (31, 10, 9.68)
assert read == sorted(read)
assert passed == list(range(len(TIMES_MS)))
PYTHON
