#!/usr/bin/env bash
# A camera that gives 10 pictures a second slows down to one a second in the dark; its MP4 keeps the times. OpenCV seeks in it.
# Guess: by time (CAP_PROP_POS_MSEC) it finds the picture of that time; by number (CAP_PROP_POS_FRAMES), some near it at worst.
# Seen with opencv-python-headless 4.14.0.94 and 5.0.0.93 on 2026-11-29, without a word: a time is turned into a number, and a number into
# a time, by the mean rate of the file (4.28 a second), as if pictures were evenly spaced. At 5 s it finds the picture of 2.7 s, at 8 s that
# of 12 s, at 13 s none, although the file has that picture; number 30 is number 47, and from 49 on there is nothing.
# After a seek CAP_PROP_POS_MSEC tells the true time of what was read, CAP_PROP_POS_FRAMES the number that was asked for. Read from the
# beginning, all pictures come with their times.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
for opencv in 4.14.0.94 5.0.0.93; do
  python3 -m venv --clear "$folder/venv"
  "$folder/venv/bin/pip" install --quiet --disable-pip-version-check "opencv-python-headless==$opencv" av==18.1.0 numpy==2.4.6
  cd "$folder"
  venv/bin/python - <<'PYTHON'
from fractions import Fraction

import av
import cv2
import numpy as np

TIMES_MS = [100 * number for number in range(50)] + [5000 + 1000 * number for number in range(10)]
MILLISECOND = Fraction(1, 1000)
with av.open("camera.mp4", "w") as container:
    stream = container.add_stream("libx264", rate=30, options={"crf": "5", "bf": "0", "g": "10"})
    stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
    stream.codec_context.time_base = MILLISECOND
    for number, time_ms in enumerate(TIMES_MS):
        frame = av.VideoFrame.from_ndarray(np.full((48, 64, 3), 20 + 3 * number, np.uint8), format="rgb24")
        frame.pts, frame.time_base = time_ms, MILLISECOND
        container.mux(stream.encode(frame))
    container.mux(stream.encode(None))


def read():
    """Return number and time of the next picture, or None."""
    read, image = capture.read()
    return (round((float(image.mean()) - 20) / 3), round(capture.get(cv2.CAP_PROP_POS_MSEC))) if read else None


def sought(where, value):
    capture.set(where, value)
    return read()


capture = cv2.VideoCapture("camera.mp4")
assert [read() for _ in TIMES_MS] == list(enumerate(TIMES_MS))
by_time = {time_ms: sought(cv2.CAP_PROP_POS_MSEC, time_ms) for time_ms in (1000, 5000, 8000, 13000)}
by_number = {number: sought(cv2.CAP_PROP_POS_FRAMES, number) for number in (10, 30, 49, 55)}
capture.set(cv2.CAP_PROP_POS_FRAMES, 30)
print(f"OpenCV {cv2.__version__}, {capture.get(cv2.CAP_PROP_FPS):.2f} a second; (number, ms) by ms {by_time}, by number {by_number}")
assert by_time == {1000: (4, 400), 5000: (27, 2700), 8000: (57, 12000), 13000: None}
assert by_number == {10: (10, 1000), 30: (47, 4700), 49: None, 55: None}
PYTHON
done
