#!/usr/bin/env bash
# Pictures at 0, 0.1, 0.2, 0.3 and 1.3 s are written to an MP4 with their times, by x264 as it is set up but for B-frames: two of them, or
# none. How long is the film, and when does the next one begin that is joined to it with FFmpeg's concat, without encoding again?
# Guess: at least 1.3 s in both cases, as B-frames change how a picture is compressed, and not when it is shown; the next begins after it.
# Seen with PyAV 18.1.0 and FFmpeg 9.0.2 (imageio-ffmpeg 0.8.1) on 2026-11-29: 1.33 s without B-frames, 0.43 s with them, without a word.
# The length is counted by the times of DECODING, where the last picture comes early. All five pictures are read in either file, at their
# times; but what is joined to the second begins at 0.43 s, and times go 0.3, 1.3, 0.43. OpenCV tells a rate of 3.75 and of 11.54.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check opencv-python-headless==4.14.0.94 av==18.1.0 imageio-ffmpeg==0.8.1 \
  numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import subprocess
from fractions import Fraction
from pathlib import Path

import av
import cv2
import imageio_ffmpeg
import numpy as np

MILLISECOND = Fraction(1, 1000)
FIRST_MS, SECOND_MS = [0, 100, 200, 300, 1300], [0, 100, 200, 300]


def write(path, times_ms, b_frames):
    with av.open(path, "w") as container:
        stream = container.add_stream("libx264", rate=30, options={"bf": str(b_frames)})
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        stream.codec_context.time_base = MILLISECOND
        for number, time_ms in enumerate(times_ms):
            frame = av.VideoFrame.from_ndarray(np.full((48, 64, 3), 20 + 10 * number, np.uint8), format="rgb24")
            frame.pts, frame.time_base = time_ms, MILLISECOND
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


def times_ms(path):
    with av.open(path) as container:
        length = float(container.duration / av.time_base)
        return [round(frame.time * 1000) for frame in container.decode(video=0)], round(length, 2)


Path("parts.txt").write_text("file first.mp4\nfile second.mp4\n")
seen = {}
for b_frames in (0, 2):
    write("first.mp4", FIRST_MS, b_frames)
    write("second.mp4", SECOND_MS, b_frames)
    options = ["-v", "error", "-y", "-f", "concat", "-i", "parts.txt", "-c", "copy", "joined.mp4"]
    subprocess.run([imageio_ffmpeg.get_ffmpeg_exe(), *options], check=True)
    rate = cv2.VideoCapture("first.mp4").get(cv2.CAP_PROP_FPS)
    (first, length), (joined, _) = times_ms("first.mp4"), times_ms("joined.mp4")
    print(f"{b_frames} B-frames: {length} s, {rate:.2f} a second; joined: {joined} ms")
    assert first == FIRST_MS
    seen[b_frames] = (length, round(rate, 2), joined)
assert seen[0] == (1.33, 3.75, [*FIRST_MS, 1333, 1433, 1533, 1633])
assert seen[2] == (0.43, 11.54, [*FIRST_MS, 433, 533, 633, 733])
PYTHON
