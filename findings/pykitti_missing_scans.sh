#!/usr/bin/env bash
# A raw drive of KITTI lacks some lidar scans: drive 0009 of 2011-09-26 has 447 images and 443 scans, and its files keep their numbers.
# Which scan goes with image 4, if scan 3 is missing? Guess: number 4; and selected frames are those of these numbers, or an error.
# Seen with pykitti 0.3.1 and kitti2mcap 0.1.1 on 2026-11-28: number 5. Scans are counted, not read by their numbers, so all behind a gap
# are 0.1 s late, one gap after another; there is no word of it, and no length of the lidar to compare.
# - `frames=range(7, 10)`: counting ends at scan 8, and then NONE is selected: image 7 comes with scan 0, image 8 with scan 1.
# - kitti2mcap takes pykitti's scans, their stamps by number from timestamps.txt, and as many frames of all sensors as there are scans:
#   the recording has scan 5 with the stamp of 4, and the last image and pose are missing.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check kitti2mcap==0.1.1 pykitti==0.3.1 mcap-ros2-support==0.6.0 \
  numpy==2.4.6 pillow==13.0.0 opencv-python-headless==4.14.0.94
cd "$folder"
venv/bin/python - <<'PYTHON'
import subprocess
from pathlib import Path

import numpy as np
import pykitti
from mcap_ros2.reader import read_ros2_messages
from PIL import Image

FRAMES, MISSING = 10, 3
day = Path("2011_09_26")
drive = day / "2011_09_26_drive_0001_sync"
for name in ("oxts", "image_02", "velodyne_points"):
    (drive / name / "data").mkdir(parents=True)
    stamps = [f"2011-09-26 13:02:2{number // 10}.{number % 10}00000000\n" for number in range(FRAMES)]
    (drive / name / "timestamps.txt").write_text("".join(stamps))
for name in ("calib_imu_to_velo.txt", "calib_velo_to_cam.txt"):
    (day / name).write_text("R: 1 0 0 0 1 0 0 0 1\nT: 0 0 0\n")
lines = [f"P_rect_0{n}: 100 0 8 0 0 100 8 0 0 0 1 0\nR_rect_0{n}: 1 0 0 0 1 0 0 0 1\n" for n in range(4)]
(day / "calib_cam_to_cam.txt").write_text("".join(lines))
for number in range(FRAMES):
    Image.new("RGB", (16, 16), (number, 0, 0)).save(drive / "image_02" / "data" / f"{number:010d}.png")
    packet = " ".join(["49.0", "8.0", "100.0", *["0"] * 22, *["1"] * 5])
    (drive / "oxts" / "data" / f"{number:010d}.txt").write_text(packet)
    if number != MISSING:
        scan = np.full((5, 4), number, dtype=np.float32)
        scan.tofile(drive / "velodyne_points" / "data" / f"{number:010d}.bin")


def pairs(**selection):
    data = pykitti.raw(".", day.name, "0001", **selection)
    count = min(len(data.cam2_files), len(data.velo_files))
    return [(data.get_cam2(i).getpixel((0, 0))[0], int(data.get_velo(i)[0, 0])) for i in range(count)]


whole, selected = pairs(), pairs(frames=range(7, 10))
print("(image, scan):", whole)
print("frames=range(7, 10):", selected)

command = ["venv/bin/kitti2mcap", "--date", day.name, "--drive", "0001", "--kitti-dir", ".", "--output", "drive.mcap"]
subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
scans, images = [], 0
for message in read_ros2_messages("drive.mcap"):
    if message.channel.topic == "/kitti/velodyne_points":
        scan = int(np.frombuffer(message.ros_msg.data, np.float32)[0])
        stamp = message.ros_msg.header.stamp
        scans.append(((stamp.sec % 10 - 5) * 10 + stamp.nanosec // 100_000_000, scan))
    images += message.channel.topic == "/kitti/camera_color_left/image_raw"
first = scans[0][0]
scans = [(tenths - first, scan) for tenths, scan in scans]
print("kitti2mcap (tenth of a second, scan):", scans, f"and {images} images")
shifted = [(n, n if n < MISSING else n + 1) for n in range(FRAMES - 1)]
assert whole == shifted
assert selected == [(7, 0), (8, 1), (9, 2)]
assert scans == shifted
assert images == FRAMES - 1
PYTHON
