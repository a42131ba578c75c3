#!/usr/bin/env bash
# Images of a road are labelled in three ways, and become COCO with label-convert, for a detector that is trained on COCO: as YOLO does it, boxes of a car (0), a lorry (1) and a
# bicycle (2); with LabelMe, a long lorry that stands aslant, as a polygon, in one image downhill, in another uphill; with labelImg, one box in each of three images. And COCO with its own numbers of categories (1 car,
# 3 bicycle, as COCO leaves gaps) becomes labels of labelImg. Guess: the same labels at the same places.
# Seen with label-convert 0.3.0 and pycocotools 2.0.11 on 2026-11-30, without a word ("Successfully convert"):
# - YOLO v8: each label has the class after its own: categories count from 0, annotations from 1. Cars are lorries, lorries bicycles; a bicycle is of a category that is not listed
# - LabelMe: the box of a lorry goes from the first to the third corner of a TURNED rectangle about it: downhill it is 200 pixels wide instead of 240, uphill -200 pixels high
# - labelImg: annotations of each image count from 0, and COCO looks annotations up by their number: asked for those of any image, pycocotools gives those of the last
# - to labelImg: a number minus one is the line in `classes.txt`, which has one line for each category: the bicycle is on line 2, and there is no such line
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check label-convert==0.3.0 opencv-python-headless==4.14.0.94 pycocotools==2.0.11 tqdm==4.69.0 pyyaml==6.0.3 numpy==2.4.6 2>/dev/null
cat > convert.py <<'PYTHON'
import contextlib
import io
import json
from pathlib import Path

import cv2
import numpy as np
from label_convert.coco_to_labelImg import COCOTolabelImg
from label_convert.labelImg_to_publaynet import LabelImgToPubLayNet
from label_convert.labelme_to_coco import LabelmeToCOCO
from label_convert.yolov8_to_coco import YOLOv8ToCOCO
from pycocotools.coco import COCO

WIDTH, HEIGHT, CLASSES = 400, 320, ["car", "lorry", "bicycle"]


def write(path, text):
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    Path(path).write_text(text)


def picture(path):
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.full((HEIGHT, WIDTH, 3), 90, np.uint8))


def loaded(path):
    with contextlib.redirect_stdout(io.StringIO()):
        return COCO(path)


for part in ("train", "val"):
    picture(f"yolo/images/{part}/road.jpg")
    write(f"yolo/labels/{part}/road.txt", "\n".join(f"{number} {0.2 + 0.25 * number} 0.5 0.1 0.1" for number in range(3)))
write("yolo/data.yaml", "names:\n" + "".join(f"  {number}: {name}\n" for number, name in enumerate(CLASSES)))
YOLOv8ToCOCO("yolo", "yolo_coco", "yolo/data.yaml")()
found = json.loads(Path("yolo_coco/annotations/instances_train2017.json").read_text())
names = {each["id"]: each["name"] for each in found["categories"]}
classes = [names.get(each["category_id"]) for each in found["annotations"]]
print("YOLO: car, lorry, bicycle are", classes)
assert classes == ["lorry", "bicycle", None]

# a lorry of about 320 x 28 pixels, with its box (60, 40, 240, 240) in both images
LORRIES = {"down": [[80, 40], [60, 60], [280, 280], [300, 260]], "up": [[60, 260], [80, 280], [300, 60], [280, 40]]}
for name, corners in LORRIES.items():
    shape = {"label": "lorry", "shape_type": "polygon", "points": corners}
    picture(f"labelme_{name}/road.jpg")
    write(f"labelme_{name}/road.json", json.dumps({"imageHeight": HEIGHT, "imageWidth": WIDTH, "shapes": [shape]}))
    LabelmeToCOCO(f"labelme_{name}", f"labelme_{name}_coco", val_ratio=0, test_ratio=0)()
    (annotation,) = json.loads(Path(f"labelme_{name}_coco/annotations/instances_train2017.json").read_text())["annotations"]
    print(f"LabelMe, lorry {name}: box", annotation["bbox"], "of (60, 40, 240, 240); area", annotation["area"])
    assert annotation["bbox"] == {"down": [80, 40, 200, 240], "up": [60, 260, 240, -200]}[name]

for number in range(3):
    picture(f"labelimg/{number}.jpg")
    write(f"labelimg/{number}.txt", f"{number} {0.2 + 0.2 * number} 0.5 0.1 0.1\n")
write("labelimg/classes.txt", "\n".join(CLASSES))
LabelImgToPubLayNet("labelimg", "publaynet", val_ratio=0, have_test=False)()
coco = loaded("publaynet/train.json")
written = {each["image_id"]: each["bbox"] for each in coco.dataset["annotations"]}
looked_up = {image: [each["bbox"] for each in coco.loadAnns(coco.getAnnIds(imgIds=[image]))] for image in written}
print("labelImg: written", written, "looked up", looked_up)
assert len({tuple(box) for box in written.values()}) == 3
assert list(looked_up.values()) == [[list(written.values())[-1]]] * 3

for part in ("train", "val"):
    picture(f"gaps/{part}2017/road.jpg")
    boxes = [{"id": each, "image_id": 1, "category_id": each, "bbox": [40 * each, 100, 30, 30], "iscrowd": 0, "area": 900} for each in (1, 3)]
    images = [{"id": 1, "file_name": "road.jpg", "width": WIDTH, "height": HEIGHT}]
    categories = [{"id": 1, "name": "car"}, {"id": 3, "name": "bicycle"}]
    write(f"gaps/annotations/instances_{part}2017.json", json.dumps({"images": images, "annotations": boxes, "categories": categories}))
COCOTolabelImg("gaps", "labelimg_out")()
lines, listed = (Path("labelimg_out/train", name).read_text().splitlines() for name in ("road.txt", "classes.txt"))
print("to labelImg:", [line.split()[0] for line in lines], "of", listed)
assert [line.split()[0] for line in lines] == ["0", "2"] and listed == ["car", "bicycle"]
PYTHON
venv/bin/python convert.py > said.txt 2> errors.txt || { cat said.txt; tail -3 errors.txt; exit 1; }
if grep -i warn errors.txt said.txt; then exit 1; fi
grep -v '^Successfully' said.txt
