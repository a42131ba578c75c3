#!/usr/bin/env bash
# A camera looks into a mirror, or is mounted upside down: the MP4 has a display matrix that says how its pictures are to be shown, here
# mirrored left to right. What do readers make of it? Guess: those that heed a rotation heed a reflection, the others leave both alone.
# Seen on 2026-11-29, for a picture whose corners are red, green / blue, white:
#   imageio-ffmpeg 0.8.1                            green, red / white, blue: mirrored, as written
#   PyAV 18.1.0, imageio 2.38.1 by PyAV             red, green / blue, white: as stored; `frame.rotation` says -180, which is another thing
#   OpenCV 4.14.0 and 5.0.0, decord2 3.4.0          white, blue / green, red: turned by 180 degrees, upside down, without a word
# Mirrored top to bottom, OpenCV, decord2 and PyAV leave it as stored, with a rotation of 0. A rotation alone is heeded by all but PyAV.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
for opencv in 4.14.0.94 5.0.0.93; do
  python3 -m venv --clear "$folder/venv"
  "$folder/venv/bin/pip" install --quiet --disable-pip-version-check "opencv-python-headless==$opencv" av==18.1.0 imageio==2.38.1 \
    imageio-ffmpeg==0.8.1 decord2==3.4.0 numpy==2.4.6
  cd "$folder"
  venv/bin/python - <<'PYTHON'
import subprocess

import av
import cv2
import decord
import imageio.v3
import imageio_ffmpeg
import numpy as np

COLOURS = {"R": (220, 30, 30), "G": (30, 220, 30), "B": (30, 30, 220), "W": (220, 220, 220)}
WIDTH, HEIGHT = 128, 64
image = np.array([COLOURS[name] for name in "RGBW"], np.uint8).reshape(2, 2, 3).repeat(HEIGHT // 2, 0).repeat(WIDTH // 2, 1)
with av.open("stored.mp4", "w") as container:
    stream = container.add_stream("libx264", rate=10, options={"crf": "5"})
    stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
    for _ in range(3):
        container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
    container.mux(stream.encode(None))


def corners(image):
    """Return the names of the colours of the four quarters, row by row."""
    height, width = image.shape[:2]
    quarters = image[height // 4 :: height // 2, width // 4 :: width // 2].reshape(4, 3).astype(int)
    return "".join(min(COLOURS, key=lambda name: abs(quarter - COLOURS[name]).sum()) for quarter in quarters)


def seen(*options):
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", "-y", *options, "-i", "stored.mp4", "-c", "copy", "shown.mp4"]
    subprocess.run(command, check=True)
    with av.open("shown.mp4") as container:
        frame = next(container.decode(video=0))
    return {
        "FFmpeg": corners(imageio.v3.imread("shown.mp4", plugin="FFMPEG", index=0)),
        "PyAV": corners(frame.to_ndarray(format="rgb24")),
        "rotation": frame.rotation,
        "imageio by PyAV": corners(imageio.v3.imread("shown.mp4", plugin="pyav", index=0)),
        "OpenCV": corners(cv2.VideoCapture("shown.mp4").read()[1][:, :, ::-1]),
        "decord": corners(decord.VideoReader("shown.mp4")[0].asnumpy()),
    }


print("OpenCV", cv2.__version__)
stored = {"PyAV": "RGBW", "imageio by PyAV": "RGBW"}
turned = seen("-display_rotation", "180")
left_to_right = seen("-display_hflip")
top_to_bottom = seen("-display_vflip")
print("turned:", turned, "\nleft to right:", left_to_right, "\ntop to bottom:", top_to_bottom)
assert turned == stored | {"rotation": -180, "FFmpeg": "WBGR", "OpenCV": "WBGR", "decord": "WBGR"}
assert left_to_right == stored | {"rotation": -180, "FFmpeg": "GRWB", "OpenCV": "WBGR", "decord": "WBGR"}
assert top_to_bottom == stored | {"rotation": 0, "FFmpeg": "BWRG", "OpenCV": "RGBW", "decord": "RGBW"}
PYTHON
done
