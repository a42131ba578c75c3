#!/usr/bin/env bash
# A nuScenes dataset has a car at a steady 10 m/s on a straight road, annotated twice a second. robometrics loads paths of objects from it (`load_nuscenes_trajectories`, which sorts them by
# time, it says) for its metrics. The table is written by time or by token, as the format leaves that open: times are in sample.json, and rows are chained by `prev` and `next`.
# In a third, a truck hides the car for 2 s, as often in nuScenes. Guess: 100 m of path and an acceleration of 0 in all three. Seen with robometrics 0.3.1 on 2026-11-30, without a word:
# - by token, 860 m and 845 m/s²: the loader looks for `timestamp` in rows of sample_annotation, which have none, and falls back to the order of rows; sample.json and the chain are not read
# - with the truck, 20 m/s²: a path has no times, so that 25 m from the last sight of the car to the next are 0.5 s for the metrics, which take one `dt`
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3.11 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check robometrics==0.3.1 numpy==2.4.6 scipy==1.17.1 2>/dev/null
cat >paths.py <<'PYTHON'
import hashlib
import json
from pathlib import Path

import numpy as np
from robometrics import path_length
from robometrics.comfort import max_acceleration
from robometrics.loaders.nuscenes import load_nuscenes_trajectories

HERTZ, SPEED_M_S = 2, 10


def token(what, index):
    return hashlib.md5(f"{what} {index}".encode()).hexdigest()


def rows(frames):
    """Return the rows of sample_annotation.json about the car, by time, where it is annotated in these of the scene's frames."""
    names = ["", *(token("annotation", frame) for frame in frames), ""]
    return [
        {
            "token": names[index + 1],
            "sample_token": token("sample", frame),
            "instance_token": token("instance", 0),
            "visibility_token": "4",
            "attribute_tokens": [],
            "translation": [frame / HERTZ * SPEED_M_S, 3.0, 0.8],
            "size": [1.9, 4.6, 1.6],
            "rotation": [1.0, 0.0, 0.0, 0.0],
            "prev": names[index],
            "next": names[index + 2],
            "num_lidar_pts": 10,
            "num_radar_pts": 1,
        }
        for index, frame in enumerate(frames)
    ]


samples = [{"token": token("sample", frame), "timestamp": 1_700_000_000_000_000 + frame * 500_000, "scene_token": token("scene", 0)} for frame in range(21)]
Path("sample.json").write_text(json.dumps(samples))
by_time = rows(range(21))
for what, table, seen in (
    ("by time", by_time, (100, 0)),
    ("by token", sorted(by_time, key=lambda row: row["token"]), (860, 845)),
    ("by time, hidden for 2 s", rows([*range(9), *range(13, 21)]), (100, 20)),
):
    Path("sample_annotation.json").write_text(json.dumps(table))
    ((instance, path_m),) = load_nuscenes_trajectories("sample_annotation.json").items()
    found = round(path_length(path_m), 3), round(max_acceleration(path_m, 1 / HERTZ), 3)
    print(f"{what}: {len(path_m)} places, {found[0]} m of path, up to {found[1]} m/s², starts at x {np.array(path_m)[:4, 0].tolist()} m")
    assert found == seen, found
PYTHON
venv/bin/python paths.py >paths.txt 2>&1 || { cat paths.txt; exit 1; }
cat paths.txt
if grep -i warn paths.txt; then exit 1; fi
