#!/usr/bin/env bash
# A ROS 2 recording (MCAP) has pictures of a red wall by three cameras, bgra8, yuv422 (as UYVY) and yuv422_yuy2, and depth of a slope from 0.5 to 2.5 m
# (16UC1). What does mcap-to-mp4 make of them? Guess: red videos, and a refusal of depth. Seen with mcap-to-mp4 0.6.0 on 2026-11-29, each with "Converted
# as 2 (or 4) channel image format": it knows bgr8 and takes all else as it lies. The wall is blue for bgra8, and grey for the YUYV camera, whose
# brightness is taken; for the UYVY one, where the first byte of a pixel is a colour, it has a dark and a light stripe by turns, a pixel wide. Of depth it
# shows the low byte, so that a slope is eight stripes. A grey camera (mono8) has no video at all: it stops with a TypeError.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check mcap-to-mp4==0.6.0 mcap-ros2-support==0.5.7 av==13.1.0 imageio==2.38.1 \
  imageio-ffmpeg==0.8.1 numpy==2.4.6 pillow==11.3.0
cd "$folder"
PATH="$folder/venv/bin:$PATH" venv/bin/python - <<'PYTHON'
import subprocess

import imageio.v3 as iio
import numpy as np
from mcap_ros2.writer import Writer

HEIGHT, WIDTH = 64, 128
IMAGE = """std_msgs/Header header
uint32 height
uint32 width
string encoding
uint8 is_bigendian
uint32 step
uint8[] data
===
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
===
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""


def video(encoding, image):
    """Record six messages of an image, convert them, and return what was said and the middle row of the first frame."""
    with open("drive.mcap", "wb") as stream:
        writer = Writer(stream)
        schema = writer.register_msgdef("sensor_msgs/msg/Image", IMAGE)
        for n in range(6):
            header = {"stamp": {"sec": 1_790_000_000, "nanosec": n * 100_000_000}, "frame_id": "camera"}
            message = {"header": header, "height": HEIGHT, "width": WIDTH, "encoding": encoding, "step": image[0].nbytes, "data": image.tobytes()}
            writer.write_message("/camera", schema, {**message, "is_bigendian": 0}, n * 100_000_000)
        writer.finish()
    run = subprocess.run(["mcap-to-mp4", "drive.mcap", "-t", "/camera", "-o", "drive.mp4"], capture_output=True, text=True)
    row = iio.imread("drive.mp4")[0, HEIGHT // 2].astype(int) if run.returncode == 0 else None
    print(f"{encoding}: {(run.stdout + run.stderr).strip().splitlines()[-2].strip()}: {row[::21].tolist() if row is not None else run.returncode}")
    return run, row


bgra = np.full((HEIGHT, WIDTH, 4), (0, 0, 255, 255), np.uint8)
uyvy = np.empty((HEIGHT, WIDTH, 2), np.uint8)
uyvy[:, 0::2], uyvy[:, 1::2] = (90, 81), (240, 81)  # red: U and Y, V and Y
depth_mm = np.tile(np.linspace(500, 2500, WIDTH).astype(np.uint16), (HEIGHT, 1))
red, green, blue = video("bgra8", bgra)[1].mean(0)
assert blue > 240 and red < 15 and green < 15
row = video("yuv422", uyvy)[1]
assert np.abs(row[0::2] - 90).max() < 15 and np.abs(row[1::2] - 240).max() < 15
assert np.abs(video("yuv422_yuy2", np.ascontiguousarray(uyvy[..., ::-1]))[1] - 81).max() <= 4
row = video("16UC1", depth_mm)[1][:, 0]
assert np.abs(row - depth_mm[0] % 256).mean() < 20 and (np.diff(row) < -100).sum() == 8
run, _ = video("mono8", np.full((HEIGHT, WIDTH), 77, np.uint8))
assert run.returncode != 0 and "TypeError" in run.stderr
PYTHON
