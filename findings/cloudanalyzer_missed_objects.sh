#!/usr/bin/env bash
# A detector of cars is judged with CloudAnalyzer (`evaluate_detection`, `ca detection-evaluate`): mAP of boxes in 3D, for a gate that lets a model pass. Of ten cars, one in
# each frame, it finds the first, or five, or all; it never reports what is not there. Another one finds all, and reports as many that are not there, all surer than the real ones.
# Guess: the area under precision over recall, as everywhere: 0.1, 0.5 and 1; and 0.5 for the other one.
# Seen with cloudanalyzer 0.6.0 on 2026-11-30, without a word: 1, 1, 1, and 0.5. Cars that were not found cost nothing: from the recall that was reached up to 1, the last
# precision goes on, where it is to be 0. So a detector that says next to nothing has the best mAP, and of two that are otherwise alike the one with the higher threshold
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check cloudanalyzer==0.6.0 open3d==0.19.0 numpy==2.4.6
venv/bin/python - <<'PYTHON'
import json

from ca.detection import evaluate_detection

FRAMES = 10


def write(name, cars):
    """Write frames of boxes: `cars` has, for each frame, what is at which x, and how sure."""
    box = {"label": "car", "size": [4.2, 1.8, 1.5], "yaw": 0.0}
    frames = [{"frame_id": str(number), "boxes": [box | {"center": [x_m, 0, 0], "score": score} for x_m, score in boxes]} for number, boxes in enumerate(cars)]
    with open(name, "w") as file:
        json.dump({"frames": frames}, file)


def judge(cars):
    write("found.json", cars)
    judged = evaluate_detection("found.json", "real.json", iou_thresholds=[0.5])
    result = judged["primary_threshold_result"]
    return judged["mAP"], result["recall"], result["precision"]


write("real.json", [[(20.0, 1.0)]] * FRAMES)
for found in (1, 5, 10):
    map_, recall, precision = judge([[(20.0, 0.9)]] * found + [[]] * (FRAMES - found))
    print(f"{found} of {FRAMES} cars: recall {recall}, precision {precision}, mAP {map_}")
    assert (map_, recall, precision) == (1, found / FRAMES, 1)
map_, recall, precision = judge([[(20.0, 0.5), (60.0, 0.9)]] * FRAMES)
print(f"all, and as many that are not there: recall {recall}, precision {precision}, mAP {map_:.2f}")
assert (round(map_, 9), recall, precision) == (0.5, 1, 0.5)
PYTHON
