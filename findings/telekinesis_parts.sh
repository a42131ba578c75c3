#!/usr/bin/env bash
# A picker's camera sees boxes on a pallet, labelled as COCO with outlines. A pole in front of one splits it in two: a part of 300 x 200 pixels, drawn with 4 corners, and a strip of 20 x 200,
# whose torn edge has 12. telekinesis-dataengine makes labels for YOLO of it, `convert_dataset` to segment; YOLO has one outline per object. Guess: both parts in one outline, or the larger one.
# Seen with telekinesis-dataengine 0.0.15 on 2026-12-01, without a word: the strip alone, a fifteenth of the box: "the largest" is the one with most corners. Back to COCO, that is the object:
# its box is 20 pixels wide, where the source has 340
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3.11 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check numpy==2.4.6 pillow==13.0.0 pyyaml==6.0.4 loguru==0.7.3 2>/dev/null
venv/bin/pip install --quiet --disable-pip-version-check --no-deps telekinesis-dataengine==0.0.15 2>/dev/null
cat >parts.py <<'PYTHON'
import importlib.metadata
import importlib.util
import json
import sys
import types
from pathlib import Path

from PIL import Image

sys.modules["fiftyone"] = types.ModuleType("fiftyone")  # only its viewer is of it, and conversions do without
(source,) = [file for file in importlib.metadata.files("telekinesis-dataengine") if str(file).endswith("detection/utils.py")]
spec = importlib.util.spec_from_file_location("detection_utils", source.locate())
utils = importlib.util.module_from_spec(spec)
spec.loader.exec_module(utils)

WIDTH, HEIGHT = 640, 480
large = [100, 100, 400, 100, 400, 300, 100, 300]
strip = [420, 100, 440, 100, 436, 120, 440, 140, 437, 160, 440, 180, 435, 200, 440, 220, 438, 240, 440, 270, 440, 300, 420, 300]
box = {"id": 1, "image_id": 1, "category_id": 1, "bbox": [100, 100, 340, 200], "area": 64_000, "iscrowd": 0, "segmentation": [large, strip]}
Path("coco/train").mkdir(parents=True)
Image.new("RGB", (WIDTH, HEIGHT)).save("coco/train/000001.png")
images = [{"id": 1, "file_name": "000001.png", "width": WIDTH, "height": HEIGHT}]
Path("coco/train/_annotations.coco.json").write_text(json.dumps({"images": images, "annotations": [box], "categories": [{"id": 1, "name": "box"}]}))
utils.coco_to_yolo("coco", "yolo", task="segment")
(label,) = Path("yolo/labels").rglob("000001.txt")
(line,) = label.read_text().splitlines()
corners = [round(float(number) * (HEIGHT if index % 2 else WIDTH)) for index, number in enumerate(line.split()[1:])]
print("outline in pixels:", corners)
assert corners == strip
utils.yolo_to_coco("yolo", "back", task="segment")
(annotation,) = json.loads(next(Path("back").rglob("*.json")).read_text())["annotations"]
print("back in COCO:", [round(number, 1) for number in annotation["bbox"]], "instead of", box["bbox"])
assert [round(number) for number in annotation["bbox"]] == [420, 100, 20, 200]
PYTHON
venv/bin/python parts.py 2>said.txt || { cat said.txt; exit 1; }
test ! -s said.txt
