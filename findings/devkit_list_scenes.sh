#!/usr/bin/env bash
# What does NuScenes.list_scenes say of a dataset of one's own?
# Guess: each scene, with the number of its boxes. Seen with nuscenes-devkit 1.2.0 on 2026-11-28: a scene with one box in each of its
# three keyframes is listed with "#anns:2", as the loop over keyframes ends before the last one; and two scenes that begin in the
# same microsecond, as of a simulator whose clock begins at 0, end it in a TypeError: it sorts pairs of stamp and row, and for
# equal stamps Python compares the rows, which are dictionaries.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check nuscenes-devkit==1.2.0
"$folder/venv/bin/python" - "$folder" <<'PYTHON'
import contextlib
import io
import json
import sys
from pathlib import Path

from nuscenes.nuscenes import NuScenes
from PIL import Image

IDENTITY = {"translation": [0, 0, 0], "rotation": [1, 0, 0, 0]}


def dataset(root, begins_us):
    """Write scenes of three keyframes with one box each, and no readings; return the opened dataset."""
    scenes = range(len(begins_us))
    tables = {name: [] for name in ("instance", "sample", "sample_annotation", "scene")}
    for scene, begin_us in enumerate(begins_us):
        samples = [f"{scene}/{number}" for number in range(3)]
        chain = list(zip(samples, ["", *samples], [*samples[1:], ""]))
        tables["scene"].append({
            "token": f"{scene}", "name": f"scene_{scene}", "description": "", "log_token": "log", "nbr_samples": 3,
            "first_sample_token": samples[0], "last_sample_token": samples[-1],
        })
        tables["instance"].append({
            "token": f"{scene}", "category_token": "car", "nbr_annotations": 3,
            "first_annotation_token": samples[0], "last_annotation_token": samples[-1],
        })
        for number, (token, prev, following) in enumerate(chain):
            links = {"token": token, "prev": prev, "next": following}
            tables["sample"].append({**links, "timestamp": begin_us + 500_000 * number, "scene_token": f"{scene}"})
            tables["sample_annotation"].append({
                **links, **IDENTITY, "size": [2, 4, 1.5], "sample_token": token, "instance_token": f"{scene}",
                "visibility_token": "1", "attribute_tokens": [], "num_lidar_pts": 1, "num_radar_pts": 0,
            })
    tables |= {name: [] for name in ("attribute", "sensor", "calibrated_sensor", "ego_pose", "sample_data")}
    tables["category"] = [{"token": "car", "name": "vehicle.car", "description": ""}]
    tables["visibility"] = [{"token": "1", "level": "v80-100", "description": ""}]
    tables["log"] = [{"token": "log", "logfile": "", "vehicle": "", "date_captured": "2026-11-28", "location": "yard"}]
    tables["map"] = [{"token": "map", "log_tokens": ["log"], "category": "", "filename": "map.png"}]
    (root / "v1.0-own").mkdir(parents=True)
    Image.new("L", (1, 1)).save(root / "map.png")
    for name, rows in tables.items():
        (root / "v1.0-own" / f"{name}.json").write_text(json.dumps(rows))
    return NuScenes("v1.0-own", str(root), verbose=False)


folder = Path(sys.argv[1])
apart = dataset(folder / "apart", [0, 1])
said = io.StringIO()
with contextlib.redirect_stdout(said):
    apart.list_scenes()
print(said.getvalue().strip())
assert all(len(sample["anns"]) == 1 for sample in apart.sample)
assert said.getvalue().count("#anns:2") == 2

together = dataset(folder / "together", [0, 0])
try:
    together.list_scenes()
except TypeError as error:
    print("scenes that begin together:", error)
else:
    raise SystemExit("scenes that begin together are listed now")
PYTHON
