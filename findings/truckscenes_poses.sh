#!/usr/bin/env bash
# A truck at 25 m/s, a sensor that is triggered 40 ms after the time of the sample. Where does the devkit of TruckScenes, which comes from that of
# nuScenes, put a box in the frame of that sensor? Guess: by the ego pose of its reading, to which its `ego_pose_token` leads, as nuScenes' does.
# Seen with truckscenes-devkit 1.2.0 on 2026-11-28: `get_sample_data` never looks at that token. It takes the pose whose time is nearest to
# the sample's, so a box beside the road is 1 m too far ahead; and it looks among the poses of ALL scenes: with a second truck in the
# dataset that drove at the same time, 500 m further on, the box of the first is 490 m behind it.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check truckscenes-devkit==1.2.0
cd "$folder"
venv/bin/python -W ignore - <<'PYTHON'
import json
from pathlib import Path

from truckscenes import TruckScenes

SPEED, BOX_M = 25.0, 10.0  # m/s along x; the box stands this far ahead of the first truck at the time of its sample
SAMPLE_US, TRIGGER_US = 1_000_000, 1_040_000
NONE = [1.0, 0.0, 0.0, 0.0]


def ahead_m(version, starts):
    """Return how far ahead of the sensor the box is, in a dataset of trucks that start at these positions."""
    tables = {name: [] for name in ("attribute", "ego_motion_cabin", "ego_motion_chassis", "weather_annotation")}
    tables["category"] = [{"token": "sign", "name": "static_object.traffic_sign"}]
    tables["visibility"] = [{"token": "4", "level": "v80-100"}]
    tables["sensor"] = [{"token": "radar", "channel": "RADAR", "modality": "radar"}]
    tables["calibrated_sensor"] = [
        {"token": "radar", "sensor_token": "radar", "translation": [0, 0, 0], "rotation": NONE, "camera_intrinsic": []}
    ]
    tables |= {name: [] for name in ("ego_pose", "instance", "sample", "sample_annotation", "sample_data", "scene")}
    for truck, start_m in enumerate(starts):
        sample = f"sample{truck}"
        tables["scene"].append({"token": f"scene{truck}", "first_sample_token": sample, "last_sample_token": sample})
        # The second truck has a pose at the very time of the first one's sample, whose own nearest is 1 ms off.
        for name, time_us in (("before", SAMPLE_US + (truck == 0) * 1000), ("reading", TRIGGER_US)):
            x = start_m + SPEED * (time_us - SAMPLE_US) * 1e-6
            pose = {"token": f"{name}{truck}", "timestamp": time_us, "translation": [x, 0, 0], "rotation": NONE}
            tables["ego_pose"].append(pose)
        tables["sample"].append({"token": sample, "timestamp": SAMPLE_US, "prev": "", "next": ""})
        data = {"token": f"data{truck}", "sample_token": sample, "ego_pose_token": f"reading{truck}", "is_key_frame": True}
        data |= {"calibrated_sensor_token": "radar", "timestamp": TRIGGER_US, "filename": "", "prev": "", "next": ""}
        tables["sample_data"].append(data)
    box = {"token": "box", "sample_token": "sample0", "instance_token": "sign", "translation": [BOX_M, 0, 0]}
    tables["sample_annotation"] = [box | {"size": [1, 1, 1], "rotation": NONE, "prev": "", "next": ""}]
    tables["instance"] = [{"token": "sign", "category_token": "sign"}]
    Path(version).mkdir()
    for name, rows in tables.items():
        Path(version, f"{name}.json").write_text(json.dumps(rows))
    devkit = TruckScenes(version, ".", verbose=False)
    (box,) = devkit.get_sample_data("data0")[1]
    return float(box.center[0])


right = BOX_M - SPEED * (TRIGGER_US - SAMPLE_US) * 1e-6
alone, beside = ahead_m("v1.0-mini", [0.0]), ahead_m("v1.1-mini", [0.0, 500.0])
print(f"{right:.3f} m ahead is right; alone {alone:.3f} m, with a second truck {beside:.3f} m")
assert abs(alone - (right + 1)) < 0.03
assert abs(beside - (BOX_M - 500)) < 0.03
PYTHON
