#!/usr/bin/env bash
# A vehicle has two cameras, whose images are triggered together and named by number, each camera in a folder of its own: CAM_FRONT/000001.jpg and CAM_LEFT/000001.jpg. Their labels,
# COCO, with a box each, become those of YOLO; and labels of YOLO, in the same folders, become COCO. Guess: two files of labels, or an error; and two boxes again.
# Seen with yolococo 0.2.1 on 2026-11-30, without a word:
# - to YOLO: ONE file, 000001.txt, with the box of the second camera
# - back, both cameras have that box: in front is a lorry where none is. With labels in the cameras' folders (labels/CAM_FRONT/000001.txt) there are two images, and not one box
# labelformat 0.1.17 writes two files, each in its folder; dataflow-cv 3.0.0 writes one, too, and warns of it.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check yolococo==0.2.1 dataflow-cv==3.0.0 labelformat==0.1.17 pillow==12.3.0 2>/dev/null
cat > names.py <<'PYTHON'
import json
import subprocess
from pathlib import Path

from PIL import Image

CAMERAS = {"CAM_FRONT": [100, 200, 200, 40], "CAM_LEFT": [400, 100, 50, 50]}
for camera in CAMERAS:
    Path("images", camera).mkdir(parents=True)
    Image.new("RGB", (640, 480)).save(f"images/{camera}/000001.jpg")
images = [{"id": number, "file_name": f"{camera}/000001.jpg", "width": 640, "height": 480} for number, camera in enumerate(CAMERAS, 1)]
labels = [{"id": number, "image_id": number, "category_id": 1, "bbox": box, "area": box[2] * box[3], "iscrowd": 0} for number, box in enumerate(CAMERAS.values(), 1)]
Path("coco.json").write_text(json.dumps({"images": images, "annotations": labels, "categories": [{"id": 1, "name": "lorry"}]}))


def run(command):
    done = subprocess.run(["venv/bin/" + command.split()[0], *command.split()[1:]], check=True, capture_output=True, text=True)
    return done.stdout + done.stderr


def written(root):
    """Return by file the middle of its first box, in pixels."""
    rows = {str(path.relative_to(root)): path.read_text().split() for path in Path(root).rglob("*.txt") if path.name != "classes.txt"}
    return {name: [round(float(row[1]) * 640), round(float(row[2]) * 480)] for name, row in sorted(rows.items())}


said = run("yolococo coco2yolo --coco coco.json --out-labels yolococo/labels --out-classes yolococo/classes.txt")
warned = run("dataflow-cv convert coco2yolo coco.json dataflow")
run("labelformat convert --task object-detection --input-format coco --input-file coco.json --output-format yolov8 --output-file labelformat/data.yaml --output-split train")
print("yolococo", written("yolococo/labels"), "dataflow-cv", written("dataflow/labels"), "labelformat", written("labelformat/labels"))
assert written("yolococo/labels") == written("dataflow/labels") == {"000001.txt": [425, 125]}
assert not any(word in said.lower() for word in ("warn", "overw", "duplicate")) and "overwrites" in warned
assert written("labelformat/labels") == {"CAM_FRONT/000001.txt": [200, 220], "CAM_LEFT/000001.txt": [425, 125]}


def back(labels_folder):
    run(f"yolococo yolo2coco --images images --labels {labels_folder} --file-name-mode relative --out back.json")
    found = json.loads(Path("back.json").read_text())
    names = {image["id"]: image["file_name"] for image in found["images"]}
    return {names[each["image_id"]]: each["bbox"] for each in found["annotations"]}


for camera, (x, y, width, height) in CAMERAS.items():
    Path("folders", camera).mkdir(parents=True)
    Path("folders", camera, "000001.txt").write_text(f"0 {(x + width / 2) / 640} {(y + height / 2) / 480} {width / 640} {height / 480}\n")
print("back:", back("yolococo/labels"), "of folders:", back("folders"))
assert back("folders") == {}
both = back("yolococo/labels")
assert len(both) == 2 and all(abs(box[0] - 400) < 0.1 and abs(box[1] - 100) < 0.1 for box in both.values())
PYTHON
venv/bin/python names.py
