#!/usr/bin/env bash
# A video of 100 frames is labelled in CVAT, in two jobs of 50 frames, with tracks of keyframes: a parked car, turned by 30 degrees, is drawn once, in frame 0 (a track goes on as it is until it is marked as outside, or the
# job ends); a cyclist in frames 10 and 30, outside from 40 on; a lorry in the second job; and a sign as a single shape. The task's backup is read with cvat-reader.
# Guess: boxes of the car in 50 frames, with its angle, of the cyclist in 30, of the lorry in 50, and of the sign in 1.
# Seen with cvat-reader 0.3.1 on 2026-11-30, without a word: one box of the car, in frame 0: tracks end with their last keyframe, and reading ends with the last one of all, after frame 40 of 100.
# The lorry and the sign are missing: only the tracks of the first job are read. Corners lose what is behind the point; a turn is not looked at
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check setuptools==80.9.0 wheel==0.45.1 2>/dev/null
venv/bin/pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation cvat-reader==0.3.1 2>/dev/null
cat > tracks.py <<'PYTHON'
import json
import zipfile
from collections import Counter

from cvat_reader import open_cvat


def shape(frame, points, *, outside=False, rotation=0.0):
    return {"type": "rectangle", "occluded": False, "outside": outside, "z_order": 0, "rotation": rotation, "points": points, "frame": frame, "attributes": []}


def track(label, *shapes):
    return {"frame": shapes[0]["frame"], "group": 0, "source": "manual", "attributes": [], "shapes": list(shapes), "label": label}


car = track("car", shape(0, [100.9, 200.0, 180.9, 250.0], rotation=30.0))
cyclist = track("cyclist", shape(10, [300.0, 200.0, 320.0, 250.0]), shape(30, [400.0, 200.0, 420.0, 250.0]), shape(40, [450.0, 200.0, 470.0, 250.0], outside=True))
lorry = track("lorry", shape(50, [500.0, 100.0, 700.0, 250.0]))
sign = {"type": "rectangle", "occluded": False, "z_order": 0, "rotation": 0.0, "points": [10.0, 10.0, 30.0, 30.0], "frame": 5, "group": 0, "source": "manual", "attributes": [], "label": "sign"}
jobs = [{"version": 0, "tags": [], "shapes": [sign], "tracks": [car, cyclist]}, {"version": 0, "tags": [], "shapes": [], "tracks": [lorry]}]
task = {"name": "drive", "labels": [{"name": name, "attributes": []} for name in ("car", "cyclist", "lorry", "sign")], "jobs": [{"start_frame": 0, "stop_frame": 49}, {"start_frame": 50, "stop_frame": 99}]}
with zipfile.ZipFile("backup.zip", "w") as backup:
    backup.writestr("task.json", json.dumps(task))
    backup.writestr("annotations.json", json.dumps(jobs))
    backup.writestr("data/drive.mp4", b"")

with open_cvat("backup.zip", load_video=False) as dataset:
    frames = list(dataset)
visible = Counter(annotation.label for frame in frames for annotation in frame.annotations if not annotation.outside)
(first,) = (annotation for annotation in frames[0].annotations if annotation.label == "car")
print(f"frames: {len(frames)} of 100; boxes: {dict(visible)}; the car: {first.bounding_box}, {[name for name in vars(first) if 'rot' in name]}")
assert len(frames) == 41 and frames[-1].frame_id == 40 and visible == {"car": 1, "cyclist": 30}
assert first.bounding_box == ((100, 200), (180, 250)) and not hasattr(first, "rotation")
PYTHON
venv/bin/python tracks.py > said.txt 2>&1 || { tail -5 said.txt; exit 1; }
if grep -i warn said.txt; then exit 1; fi
cat said.txt
