#!/usr/bin/env bash
# An episode is cut out of an MP4 without encoding it again (`ffmpeg -ss 1.45 -c copy`): the file begins at the key frame before the cut,
# and an edit list says where the film begins. What do readers make of frame 0? Guess: the first picture after the cut, at 0 s.
# Seen on 2026-11-28, for 15 stored pictures, 15 to 24 of them behind the cut:
#   PyAV 18.1.0, OpenCV 4.14.0   pictures 15 to 24, at 0 to 0.9 s; OpenCV counts 15 frames before it reads them
#   decord2 3.4.0 and decord 0.6.0   15 frames, at -0.5 to 0.9 s: picture 15 is frame 0, at -0.5 s, which puts every picture half a second
#     too early, and the last is repeated five times. Only where it repeats more than four, a warning
#     speaks of "corrupted" ones.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
for decord in decord2==3.4.0 decord==0.6.0; do
  python3 -m venv --clear venv
  venv/bin/pip install --quiet --disable-pip-version-check "$decord" av==18.1.0 imageio-ffmpeg==0.8.1 numpy==2.4.6 \
    opencv-python-headless==4.14.0.94
  echo "$decord"
  venv/bin/python - 2>errors.txt <<'PYTHON' || { tail -5 errors.txt; exit 1; }
import subprocess

import av
import cv2
import decord
import imageio_ffmpeg
import numpy as np

STORED, SHOWN = 15, list(range(15, 25))


def number(pixels):
    return round((float(np.mean(pixels)) - 20) / 7)


with av.open("whole.mp4", "w") as container:
    options = {"crf": "5", "bf": "0", "g": "10", "keyint_min": "10", "sc_threshold": "0"}
    stream = container.add_stream("libx264", rate=10, options=options)
    stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
    for count in range(30):
        grey = np.full((48, 64, 3), 20 + 7 * count, np.uint8)
        container.mux(stream.encode(av.VideoFrame.from_ndarray(grey, format="rgb24")))
    container.mux(stream.encode(None))
ffmpeg = imageio_ffmpeg.get_ffmpeg_exe()
cut = ["-ss", "1.45", "-i", "whole.mp4", "-t", "1", "-c", "copy", "cut.mp4"]
subprocess.run([ffmpeg, "-v", "error", "-y", *cut], check=True)

with av.open("cut.mp4") as container:
    seen = [(round(frame.time, 3), number(frame.to_ndarray(format="gray"))) for frame in container.decode(video=0)]
print("PyAV:", seen)
assert seen == [(round(i / 10, 3), picture) for i, picture in enumerate(SHOWN)]

capture = cv2.VideoCapture("cut.mp4")
counted, seen = int(capture.get(cv2.CAP_PROP_FRAME_COUNT)), []
while True:
    there, pixels = capture.read()
    if not there:
        break
    seen.append(number(pixels))
print(f"OpenCV: {counted} frames counted, read:", seen)
assert (counted, seen) == (STORED, SHOWN)

reader = decord.VideoReader("cut.mp4")
begins = reader.get_frame_timestamp(range(len(reader)))[:, 0]
seen = [(round(float(begin), 3), number(reader[i].asnumpy())) for i, begin in enumerate(begins)]
print("decord:", seen)
assert seen == [(round(i / 10 - 0.5, 3), min(SHOWN[0] + i, SHOWN[-1])) for i in range(STORED)]
PYTHON
done
