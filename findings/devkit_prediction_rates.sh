#!/usr/bin/env bash
# A dataset in nuScenes' format has keyframes at another rate than nuScenes' own 2 Hz: 10 Hz, or 1 Hz. A car drives at a constant 10 m/s, and its
# next 6 s are asked for (`get_future_for_agent`, in seconds). Guess: its positions in the next 6 s, the last of them 60 m ahead.
# Seen with nuscenes-devkit 1.2.0 on 2026-11-29: as many positions as 2 Hz would have, whatever the stamps say.
#    2 Hz   12 positions, the last 60 m ahead
#   10 Hz   12 positions, the last 12 m ahead: 1.2 s
#    1 Hz    6 positions, the last 60 m ahead: two rows are a second apart, where models take them for half a second
# `ConstantVelocityHeading`, which is right for this car, then misses by 26 m on average (10 Hz), or its twelve rows fit the six by no metric.
# Nothing is said. A track that misses keyframes is the same: its rows are those that are there, one behind the other.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check nuscenes-devkit==1.2.0
"$folder/venv/bin/python" - "$folder" <<'PYTHON'
import json
import sys
from pathlib import Path

import numpy as np
from nuscenes.nuscenes import NuScenes
from nuscenes.prediction import PredictHelper
from nuscenes.prediction.models.physics import ConstantVelocityHeading
from PIL import Image

ROTATION = {"rotation": [1, 0, 0, 0]}
START_US = 1_700_000_000_000_000


def neighbours(name, number, count):
    """Return the links of a row to the one before and the one behind it."""
    return {"prev": f"{name}{number - 1}" if number else "", "next": f"{name}{number + 1}" if number < count - 1 else ""}


def dataset(root, rate_hz, missing=()):
    """Write a scene of 10 s with a car at 10 m/s; return the opened dataset. The car has no box in the keyframes `missing`."""
    count = 10 * rate_hz + 1
    boxes = [number for number in range(count) if number not in missing]
    tables = {name: [] for name in ("attribute", "visibility", "calibrated_sensor", "ego_pose", "sample_data", "sensor")} | {
        "category": [{"token": "car", "name": "vehicle.car", "description": ""}],
        "log": [{"token": "log", "logfile": "", "vehicle": "", "date_captured": "2026-11-29", "location": "here"}],
        "map": [{"token": "map", "log_tokens": ["log"], "category": "", "filename": "map.png"}],
        "scene": [{
            "token": "scene", "name": "scene", "description": "", "log_token": "log", "nbr_samples": count,
            "first_sample_token": "s0", "last_sample_token": f"s{count - 1}",
        }],
        "sample": [
            {"token": f"s{n}", "timestamp": START_US + n * 1_000_000 // rate_hz, "scene_token": "scene", **neighbours("s", n, count)}
            for n in range(count)
        ],
        "instance": [{
            "token": "one", "category_token": "car", "nbr_annotations": len(boxes), "first_annotation_token": "a0",
            "last_annotation_token": f"a{len(boxes) - 1}",
        }],
        "sample_annotation": [{
            "token": f"a{index}", "sample_token": f"s{n}", "instance_token": "one", "attribute_tokens": [], "visibility_token": "",
            "translation": [10 * n / rate_hz, 0, 0], "size": [2, 4, 2], "num_lidar_pts": 9, "num_radar_pts": 0, **ROTATION,
            **neighbours("a", index, len(boxes)),
        } for index, n in enumerate(boxes)],
    }  # fmt: skip
    (root / "v1.0-own").mkdir(parents=True)
    Image.new("L", (1, 1)).save(root / "map.png")
    for name, rows in tables.items():
        (root / "v1.0-own" / f"{name}.json").write_text(json.dumps(rows))
    return NuScenes("v1.0-own", str(root), verbose=False)


seen = {}
for name, rate_hz, missing in (("2 Hz", 2, ()), ("10 Hz", 10, ()), ("1 Hz", 1, ()), ("2 Hz, two missing", 2, (4, 5))):
    helper = PredictHelper(dataset(Path(sys.argv[1]) / name, rate_hz, missing))
    now = f"s{2 * rate_hz // 2}"  # a second after the start, as the velocity needs a past
    future = helper.get_future_for_agent("one", now, seconds=6, in_agent_frame=False)
    ahead = (future[:, 0] - helper.get_sample_annotation("one", now)["translation"][0]).round(6).tolist()
    predicted = ConstantVelocityHeading(6, helper)(f"one_{now}").prediction[0]
    off = float(np.linalg.norm(predicted - future, axis=1).mean().round(3)) if len(predicted) == len(future) else None
    seen[name] = len(ahead), ahead[-1], off
    print(f"{name}: {len(ahead)} positions, {ahead} m ahead; the prediction is {off} m off")
assert seen["2 Hz"] == (12, 60, 0)
assert seen["10 Hz"] == (12, 12, 26)
assert seen["1 Hz"] == (6, 60, None)
assert seen["2 Hz, two missing"][0] == 10 and seen["2 Hz, two missing"][2] is None
PYTHON
