#!/usr/bin/env bash
# A car of KITTI's odometry drives 10 m towards a pole that is 30 m ahead and 4 m to the left. kitti-odom-2012-dataloader puts its clouds into "KITTI official global
# coordinate system (RDF)", and wernstrom reads its grey cameras and IMU. Guess: the pole stands where it is, 30 m ahead; cam0 is of `image_00`, as its
# calibration; a time for each row of the IMU. Seen with kitti-odom-2012-dataloader 0.1.0 and wernstrom 0.4.4 on 2026-11-30, without a word:
# - MAP_KITTI: the camera's poses are applied to points of the lidar, whose x (ahead) is taken for the camera's (to the right): the pole is 30 m to the RIGHT and
#   4 m below, at first, and then 20 m to the right and 10 m ahead. MAP_FLU has it stand still
# - BASE_LINK, which is the default and said to be the "vehicle frame", is that of the left camera: x is to the right, and z ahead
# - `cam0` and `cam1`, "monochrome left" and "right", are the COLOUR cameras made grey, 6 cm beside; `calib.K_cam0` and `P_rect_00` are of the real ones
# - 3 rows of the IMU have 4 timestamps, and `len()` is 4, since three times 0.1 is more than 0.3
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3.12 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check kitti-odom-2012-dataloader==0.1.0 wernstrom==0.4.4 numpy==2.4.6 pillow==13.0.0 2>/dev/null
cd "$folder"
venv/bin/python - <<'PYTHON'
from pathlib import Path

import numpy as np
from kitti_odom_2012_dataloader import FrameID, PointCloudLoader
from PIL import Image
from wernstrom import raw

FRAMES = 3
camera_from_lidar = np.array([[0, -1, 0, 0.0], [0, 0, -1, -0.08], [1, 0, 0, -0.27], [0, 0, 0, 1]])
poses = np.tile(np.eye(4), (FRAMES, 1, 1))
poses[:, 2, 3] = np.linspace(0, 10, FRAMES)  # of the left camera, in its first frame: ahead
pole = camera_from_lidar @ (30.0, 4.0, 0.0, 1)


def row(matrix):
    """Return a matrix as a row of KITTI's text."""
    return " ".join(map(str, matrix[:3].ravel()))


velodyne = Path("kitti/sequences/00/velodyne")
velodyne.mkdir(parents=True)
Path("kitti/poses").mkdir()
for number, pose in enumerate(poses):
    point = np.linalg.inv(pose @ camera_from_lidar) @ pole
    np.array([*point[:3], 0.5], np.float32).tofile(velodyne / f"{number:06d}.bin")
Path("kitti/poses/00.txt").write_text("\n".join(map(row, poses)) + "\n")
Path("kitti/sequences/00/times.txt").write_text("\n".join(f"{0.1 * number:e}" for number in range(FRAMES)))
Path("kitti/sequences/00/calib.txt").write_text(f"Tr: {row(camera_from_lidar)}\n")

seen = {frame: np.array([cloud[0, :3] for cloud, _ in PointCloudLoader("kitti/sequences/00", frame)]) for frame in FrameID}
first, last = (seen[FrameID.MAP_KITTI][at].round(2).tolist() for at in (0, -1))
print(f"pole at (right, down, ahead) {pole[:3].round(2).tolist()}; MAP_KITTI {first} to {last}")
assert np.allclose(first, (30, 4, 0), atol=0.01) and np.allclose(last, (20, 4, 10), atol=0.01)
assert np.ptp(seen[FrameID.MAP_FLU], axis=0).max() < 0.5
print(f"BASE_LINK of the first frame: {seen[FrameID.BASE_LINK][0].round(2).tolist()}")
assert np.allclose(seen[FrameID.BASE_LINK][0], pole[:3], atol=0.01)

for camera, grey in (("image_00", 10), ("image_01", 20), ("image_02", 200), ("image_03", 210)):
    Path("tracking", camera, "0000").mkdir(parents=True)
    Image.new("L" if grey < 100 else "RGB", (8, 4), grey if grey < 100 else (grey,) * 3).save(f"tracking/{camera}/0000/000000.png")
for part in ("calib", "oxts"):
    Path("tracking", part).mkdir()
baselines = (0.0, -387.5744, 44.85728, -339.5242)
lines = [f"P{number}: 721.5377 0 609.5593 {baseline} 0 721.5377 172.854 0 0 0 1 0" for number, baseline in enumerate(baselines)]
Path("tracking/calib/0000.txt").write_text("\n".join(lines) + "\n")
Path("tracking/oxts/0000.txt").write_text((" ".join(["49.0", "8.4", "115"] + ["0"] * 27) + "\n") * FRAMES)
drive = raw("tracking", "00")
beside = drive.calib.P_rect_20[0, 3] / drive.calib.P_rect_20[0, 0]
print(f"cam0 {drive.get_cam0(0)[0, 0]}, cam1 {drive.get_cam1(0)[0, 0]}: files of grey 10 and 20; cameras {beside:.2f} m beside; {len(drive.imu)} rows, {len(drive)} times")
assert (drive.get_cam0(0) == 200).all() and (drive.get_cam1(0) == 210).all() and round(beside, 2) == 0.06
assert len(drive.imu) == FRAMES and len(drive) == FRAMES + 1
PYTHON
