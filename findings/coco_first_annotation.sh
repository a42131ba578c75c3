#!/usr/bin/env bash
# Labels are exported from Label Studio as COCO, and a detector that finds each box exactly is evaluated with pycocotools.
# Guess: the average precision is 1. Seen with label-studio-sdk 2.1.2 and pycocotools 2.0.11 on 2026-11-28: 0.252 for two boxes. The export
# counts annotations from 0, and the evaluation keeps for each detection the id of the annotation that it matched, 0 standing for none: the
# detection of annotation 0 is a false alarm, while its box counts as found. With ids from 1 on it is 1. Nothing is said on either side.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check label-studio-sdk==2.1.2 pycocotools==2.0.11 pillow==13.0.0 numpy==2.2.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import contextlib
import io
import json
from pathlib import Path

from label_studio_sdk.converter import Converter
from PIL import Image
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval

LAYOUT = (
    '<View><Image name="image" value="$image"/>'
    '<RectangleLabels name="label" toName="image"><Label value="car"/></RectangleLabels></View>'
)
Image.new("RGB", (200, 100)).save("0.png")
results = []
for number, x in enumerate((10, 60)):
    value = {"x": x, "y": 20, "width": 25, "height": 50, "rotation": 0, "rectanglelabels": ["car"]}
    result = {"id": str(number), "type": "rectanglelabels", "from_name": "label", "to_name": "image", "value": value}
    results.append(result | {"original_width": 200, "original_height": 100})
image = str(Path("0.png").resolve())
Path("tasks.json").write_text(
    json.dumps([{"id": 1, "data": {"image": image}, "annotations": [{"id": 1, "result": results}]}])
)
Converter(LAYOUT, ".", download_resources=False).convert_to_coco("tasks.json", "coco", is_dir=False)


def precision(labels):
    """Return the average precision of a detector whose boxes are the labels."""
    Path("labels.json").write_text(json.dumps(labels))
    found = []
    for score, label in zip((0.9, 0.8), labels["annotations"], strict=True):
        found.append({name: label[name] for name in ("image_id", "category_id", "bbox")} | {"score": score})
    with contextlib.redirect_stdout(io.StringIO()):
        truth = COCO("labels.json")
        evaluation = COCOeval(truth, truth.loadRes(found), "bbox")
        evaluation.evaluate()
        evaluation.accumulate()
        evaluation.summarize()
    return round(float(evaluation.stats[0]), 3)


labels = json.loads(Path("coco/result.json").read_text())
ids = [label["id"] for label in labels["annotations"]]
exported = precision(labels)
for label in labels["annotations"]:
    label["id"] += 1
print(f"ids {ids}: {exported}; from 1 on: {precision(labels)}")
assert ids == [0, 1]
assert exported == 0.252
assert precision(labels) == 1.0
PYTHON
