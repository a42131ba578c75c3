#!/usr/bin/env bash
# A car of MulRan, whose Ouster looks backwards, drives past a pole. autodataloader converts the drive into one layout, with "gt" poses for each lidar; each
# cloud is put into the map by the pose that it has for it, `pose_at(..., sensor="ouster")`. Guess: the pole stands still, where it is.
# Seen with autodataloader 0.1.1 on 2026-11-30, without a word: it moves along with the car at twice its speed, on the wrong side of the road. MulRan's
# `global_pose.csv` is of the car, and is passed on for the Ouster, too; its mount (1.70 m ahead, 1.80 m up, turned by 179.67 degrees) is not in the
# converted dataset. HeLiPR, whose poses are of each lidar, comes out as the same "gt"
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check autodataloader==0.1.1 numpy==2.4.6 pyyaml==6.0.3 2>/dev/null
cd "$folder"
venv/bin/python - <<'PYTHON'
from pathlib import Path

import numpy as np
from dataloader import Dataset, convert_dataset

BEGIN_NS, SPEED, POLE = 1_564_718_063_000_000_000, 10.0, np.array([30.0, 4.0, 1.0, 1.0])  # the pole is ahead, and to the left
YAW = np.radians(179.6654)
mount = np.array([[np.cos(YAW), -np.sin(YAW), 0, 1.7042], [np.sin(YAW), np.cos(YAW), 0, -0.021], [0, 0, 1, 1.8047], [0, 0, 0, 1]])  # car_SE3_ouster

clouds = Path("DRIVE01/sensor_data/Ouster")
clouds.mkdir(parents=True)
stamps, poses = [], []
for number in range(11):
    at_ns, car = BEGIN_NS + number * 100_000_000, np.eye(4)
    car[0, 3] = SPEED * 0.1 * number
    x, y, z, _ = np.linalg.inv(car @ mount) @ POLE
    np.array([x, y, z, 100.0], np.float32).tofile(clouds / f"{at_ns}.bin")
    stamps.append(f"{at_ns},ouster")
    poses.append(",".join(map(str, [at_ns, *car[:3].ravel()])))
Path("DRIVE01/sensor_data/data_stamp.csv").write_text("\n".join(stamps) + "\n")
Path("DRIVE01/global_pose.csv").write_text("\n".join(poses) + "\n")

result = convert_dataset(dataset="mulran", source="DRIVE01", output_root="converted", verbose=False)
assert result["ok"]
dataset = Dataset(result["sequence_dir"])
seen, right = [], []
for event in dataset.sensor_events("ouster"):
    point = np.append(event.as_lidar().numpy()[0, :3], 1)
    pose = dataset.pose_at(event.timestamp_ns, sensor="ouster").matrix()
    seen.append((pose @ point)[:2])
    right.append((pose @ mount @ point)[:2])
seen, right = np.array(seen), np.array(right)
print(f"pole at {POLE[:2].tolist()}: seen from {seen[0].round(1)} to {seen[-1].round(1)}; with the mount {right[0].round(2)} to {right[-1].round(2)}")
assert np.allclose(right, POLE[:2], atol=0.01)
assert np.allclose(np.diff(seen[:, 0]), 2 * SPEED * 0.1, atol=0.01) and seen[:, 1].max() < -3
text = Path(result["manifest_path"]).read_text()
assert "1.70" not in text and not [key for key in ("extrinsic", "mount", "transform", "calib") if key in text.lower()]
PYTHON
