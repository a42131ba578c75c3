#!/usr/bin/env bash
# The devkit's export_poses writes latitude and longitude of each ego pose. Does it do so for a dataset of one's own?
# Guess: for any dataset that NuScenes loads, if the place has a reference. Seen with nuscenes-devkit 1.2.0 on 2026-11-28: it asks for
# the ego pose with the token of the reading, not with the reading's ego_pose_token, and ends in a KeyError unless both are the same (in
# nuScenes they are, and no documentation says so). And it takes the bearing for atan(x / y): what lies south of the
# reference comes out as far to the north and mirrored, and due east of it is a ZeroDivisionError.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check nuscenes-devkit==1.2.0
"$folder/venv/bin/python" - "$folder" <<'PYTHON'
import json
import sys
from pathlib import Path

from nuscenes.nuscenes import NuScenes
from nuscenes.scripts.export_poses import REFERENCE_COORDINATES, derive_latlon, get_poses
from PIL import Image

PLACE = "boston-seaport"
IDENTITY = {"translation": [0, 0, 0], "rotation": [1, 0, 0, 0]}
EMPTY = ("attribute", "category", "instance", "sample_annotation", "visibility")


def dataset(root, poses):
    """Write a scene of one keyframe with a lidar reading that has a pose with this token; return the opened dataset."""
    links = {"prev": "", "next": ""}
    tables = {name: [] for name in EMPTY} | {
        "log": [{"token": "log", "logfile": "", "vehicle": "", "date_captured": "2026-11-28", "location": PLACE}],
        "map": [{"token": "map", "log_tokens": ["log"], "category": "", "filename": "map.png"}],
        "sensor": [{"token": "lidar", "channel": "LIDAR_TOP", "modality": "lidar"}],
        "calibrated_sensor": [{"token": "mounted", "sensor_token": "lidar", "camera_intrinsic": [], **IDENTITY}],
        "ego_pose": [{"token": poses, "timestamp": 5, **IDENTITY}],
        "sample": [{"token": "sample", "timestamp": 5, "scene_token": "scene", **links}],
        "sample_data": [{
            "token": "reading", "sample_token": "sample", "ego_pose_token": poses, "timestamp": 5,
            "calibrated_sensor_token": "mounted", "fileformat": "pcd", "is_key_frame": True, "height": 0, "width": 0,
            "filename": "sweep.pcd.bin", **links,
        }],
        "scene": [{
            "token": "scene", "name": "scene", "description": "", "log_token": "log", "nbr_samples": 1,
            "first_sample_token": "sample", "last_sample_token": "sample",
        }],
    }
    (root / "v1.0-own").mkdir(parents=True)
    Image.new("L", (1, 1)).save(root / "map.png")
    for name, rows in tables.items():
        (root / "v1.0-own" / f"{name}.json").write_text(json.dumps(rows))
    return NuScenes("v1.0-own", str(root), verbose=False)


folder = Path(sys.argv[1])
alike, other = (dataset(folder / token, token) for token in ("reading", "pose"))
assert [pose["timestamp"] for pose in get_poses(alike, "scene")] == [5]
assert other.get("ego_pose", other.get("sample_data", "reading")["ego_pose_token"])["timestamp"] == 5
try:
    get_poses(other, "scene")
except KeyError as error:
    print("a pose with a token of its own: KeyError:", error)
else:
    raise SystemExit("poses with tokens of their own are found now")

latitude, longitude = REFERENCE_COORDINATES[PLACE]
(south,) = derive_latlon(PLACE, [{"timestamp": 0, "translation": [300.0, -400.0, 0.0]}])
print("300 m east and 400 m south of", (latitude, longitude), "is", (south["latitude"], south["longitude"]))
assert south["latitude"] > latitude and south["longitude"] < longitude
try:
    derive_latlon(PLACE, [{"timestamp": 0, "translation": [300.0, 0.0, 0.0]}])
except ZeroDivisionError as error:
    print("due east of it: ZeroDivisionError:", error)
else:
    raise SystemExit("due east of the reference there is an answer now")
PYTHON
