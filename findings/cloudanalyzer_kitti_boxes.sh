#!/usr/bin/env bash
# Labels of KITTI (`label_2`, in the frame of the camera) become boxes in the frame of the lidar with CloudAnalyzer (`parse_kitti_label_file`, `ca kitti-convert`), as the truth that
# a detector is judged by. A car 20 m ahead drives away; another one crosses to the right, as `rotation_y` of 0 is along the camera's x. One drives at 45 degrees between.
# Guess: yaws of 0, -90 and -45 degrees, x being ahead and y left; lengths are along the heading.
# Seen with cloudanalyzer 0.6.0 on 2026-11-30, without a word: 90, 0 and 45 degrees: `rotation_y` with the other sign, and no quarter turn from one frame into the
# other. So cars lie across the road that drive along it. A detector that finds the car exactly overlaps with it by 0.27, and is wrong by its own judge
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check cloudanalyzer==0.6.0 open3d==0.19.0 numpy==2.4.6
venv/bin/python - <<'PYTHON'
import json
import math
import os

from ca.detection import evaluate_detection
from ca.kitti import convert_kitti_labels, parse_kitti_label_file

LENGTH_M, WIDTH_M, HEIGHT_M = 4.2, 1.8, 1.5
SEEN_DEG = {"away": (-90, 0, 90), "to the right": (0, -90, 0), "between": (-45, -45, 45)}  # rotation_y, yaw in the lidar's frame, yaw that is found


def label(rotation_y_rad):
    return f"Car 0 0 0 600 150 700 200 {HEIGHT_M} {WIDTH_M} {LENGTH_M} 0 1.65 20 {rotation_y_rad:.6f}\n"


for name, (rotation_y_deg, yaw_deg, found_deg) in SEEN_DEG.items():
    rotation_y_rad = math.radians(rotation_y_deg)
    ahead, left = -math.sin(rotation_y_rad), -math.cos(rotation_y_rad)  # a heading is (cos, 0, -sin) in the camera's frame, whose z is ahead and x right
    assert round(math.degrees(math.atan2(left, ahead))) == yaw_deg
    with open("label.txt", "w") as file:
        file.write(label(rotation_y_rad))
    (box,) = parse_kitti_label_file("label.txt")
    print(f"{name}: size {box['size']}, yaw {math.degrees(box['yaw']):.0f} degrees, heading {yaw_deg}")
    assert box["size"] == [LENGTH_M, WIDTH_M, HEIGHT_M] and round(math.degrees(box["yaw"])) == found_deg

os.mkdir("label_2")
with open("label_2/000000.txt", "w") as file:
    file.write(label(math.radians(-90)))
convert_kitti_labels("label_2", "real.json")
with open("real.json") as file:
    center = json.load(file)["frames"][0]["boxes"][0]["center"]
with open("found.json", "w") as file:
    box = {"label": "Car", "center": center, "size": [LENGTH_M, WIDTH_M, HEIGHT_M], "yaw": 0.0, "score": 0.9}
    json.dump({"frames": [{"frame_id": "000000", "boxes": [box]}]}, file)
overlaps = [evaluate_detection("found.json", "real.json", iou_thresholds=[limit])["primary_threshold_result"]["mean_iou"] for limit in (0.2, 0.5)]
print(f"found exactly: overlap {overlaps[0]:.2f}, and none at a limit of 0.5")
assert abs(overlaps[0] - WIDTH_M / (2 * LENGTH_M - WIDTH_M)) < 0.01 and overlaps[1] == 0
PYTHON
