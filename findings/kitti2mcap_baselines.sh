#!/usr/bin/env bash
# A raw drive of KITTI becomes an MCAP of ROS 2 with kitti2mcap: four cameras, their CameraInfo, and where they are mounted on /tf_static. At which pixel
# does a lidar point 20 m ahead lie, for the drive (pykitti) and for whoever projects with P of CameraInfo, as ROS does for rectified images?
# Guess: at the same, as both have the calibration of the drive. Seen with kitti2mcap 0.1.1 and pykitti 0.3.1 on 2026-11-29, without a word: at the same for
# camera 0; 19.6 pixels to the left for camera 1, 17.2 for camera 3, and 2.3 to the right for camera 2. P leads from the frame of camera 0, so its
# fourth column is the way from there (0.54 m); but each camera has a frame of its own on /tf_static, at its own centre, so that the way counts twice.
# K with that frame is right, and so is P with the frame of camera 0.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check kitti2mcap==0.1.1 pykitti==0.3.1 mcap==1.6.0 mcap-ros2-support==0.6.0 \
  numpy==2.4.6 pillow==13.0.0
cd "$folder"
cat > drive.py <<'PYTHON'
from pathlib import Path

import numpy as np
from PIL import Image

FOCAL_PX, CENTRE_PX = 721.5377, (609.5593, 172.854)
FOURTH_COLUMN = {0: 0.0, 1: -387.5744, 2: 44.85728, 3: -339.5242}  # pixels times metres, as calibration of that day has it
LIDAR_POINT = [20.0, 1.0, 0.5]

day = Path("2011_09_26")
drive = day / "2011_09_26_drive_0001_sync"


def calibration(name, rows):
    (day / name).write_text("".join(f"{key}: {' '.join(f'{value:.9e}' for value in np.ravel(values))}\n" for key, values in rows.items()))


def folder(name):
    (drive / name / "data").mkdir(parents=True)
    (drive / name / "timestamps.txt").write_text("2011-09-26 13:02:25.961661696\n")
    return drive / name / "data"


k = np.array([[FOCAL_PX, 0, CENTRE_PX[0]], [0, FOCAL_PX, CENTRE_PX[1]], [0, 0, 1]])
rows = {}
for camera, fourth in FOURTH_COLUMN.items():
    Image.new("L" if camera < 2 else "RGB", (1242, 375)).save(folder(f"image_{camera:02d}") / "0000000000.png")
    rows |= {f"R_rect_{camera:02d}": np.eye(3), f"P_rect_{camera:02d}": np.column_stack([k, [fourth, 0, 0]])}
calibration("calib_cam_to_cam.txt", rows)
calibration("calib_velo_to_cam.txt", {"R": [[0, -1, 0], [0, 0, -1], [1, 0, 0]], "T": [0, -0.08, -0.27]})
calibration("calib_imu_to_velo.txt", {"R": np.eye(3), "T": [-0.81, 0.32, -0.8]})
np.array(LIDAR_POINT + [0.3], np.float32).tofile(folder("velodyne_points") / "0000000000.bin")
(folder("oxts") / "0000000000.txt").write_text(" ".join(["49.0", "8.4", "110", "0", "0", "0.5"] + ["0.0"] * 19 + ["4", "8", "5", "5", "6"]))
PYTHON
venv/bin/python drive.py
venv/bin/kitti2mcap --date 2011_09_26 --drive 0001 --kitti-dir . --cameras 0,1,2,3 --output drive.mcap >log
venv/bin/python - <<'PYTHON'
import numpy as np
import pykitti
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

FRAMES = ("camera_gray_left", "camera_gray_right", "camera_color_left", "camera_color_right")
OFF_PX = (0, -19.6, 2.3, -17.2)


def pixel(projected):
    return projected[:2] / projected[2]


infos, places = {}, {}
with open("drive.mcap", "rb") as stream:
    for _, channel, _, message in make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages():
        if channel.topic.endswith("camera_info"):
            infos[message.header.frame_id] = message
        if channel.topic == "/tf_static":
            places = {each.child_frame_id: each.transform.translation for each in message.transforms}
calibration = pykitti.raw(".", "2011_09_26", "0001").calib
lidar_point = np.array([20.0, 1.0, 0.5, 1.0])
assert np.isclose(places[FRAMES[0]].y - places[FRAMES[1]].y, 387.5744 / 721.5377)  # each frame at its own centre
for camera, frame in enumerate(FRAMES):
    cam_point = getattr(calibration, f"T_cam{camera}_velo") @ lidar_point
    right = pixel(getattr(calibration, f"K_cam{camera}") @ cam_point[:3])
    p = np.array(infos[frame].p).reshape(3, 4)
    print(f"{frame}: {right.round(1).tolist()} in the drive, {pixel(p @ cam_point).round(1).tolist()} by P in its frame")
    assert np.allclose(pixel(np.array(infos[frame].k).reshape(3, 3) @ cam_point[:3]), right)
    assert np.allclose(pixel(p @ (calibration.T_cam0_velo @ lidar_point)), right)
    assert np.allclose(pixel(p @ cam_point) - right, [OFF_PX[camera], 0], atol=0.1)
PYTHON
