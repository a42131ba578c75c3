#!/usr/bin/env bash
# A lorry behind a pole: its mask has two parts, 20 x 10 and 8 x 10 pixels. With `supervision` its box is made of the mask, a dataset of it is written for YOLO, and
# read again. Guess: a box of 30 x 10 pixels, from the left end of the one part to the right end of the other; and one lorry.
# Seen with supervision 0.31.2 on 2026-11-29, without a word:
# - `mask_to_xyxy` gives 29 x 9: the box ends at the middle of the last pixel, so to say, while everything else of it (`area`, IoU, COCO, YOLO) takes x2 - x1 for the width.
#   A box of 10 x 10 pixels and that of its own mask overlap by 0.81, below a threshold of 0.85
# - read from YOLO it is TWO lorries, one for each part. COCO keeps one
# - boxes in VOC are whole pixels: 5.25 becomes 5, and 6.5 becomes 7
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check supervision==0.31.2
cd "$folder"
venv/bin/python -W ignore - <<'PYTHON'
import numpy as np
import supervision
from PIL import Image

mask = np.zeros((1, 60, 80), dtype=bool)
mask[0, 10:20, 30:50] = mask[0, 10:20, 52:60] = True
box = supervision.mask_to_xyxy(mask)
print("box of the mask:", box.tolist())
assert box.tolist() == [[30, 10, 59, 19]]
square = np.zeros((1, 60, 80), dtype=bool)
square[0, 10:20, 10:20] = True
overlap = supervision.box_iou_batch(np.array([[10.0, 10, 20, 20]]), supervision.mask_to_xyxy(square).astype(float))
print("overlap of a box with that of its mask:", overlap.item())
assert abs(overlap.item() - 0.81) < 1e-6

Image.new("RGB", (80, 60)).save("road.png")


def dataset(detections):
    """Return a dataset of one image."""
    return supervision.DetectionDataset(classes=["lorry"], images=["road.png"], annotations={"road.png": detections})


lorry = dataset(supervision.Detections(xyxy=box.astype(float), mask=mask, class_id=np.array([0])))
lorry.as_yolo(images_directory_path="yolo/images", annotations_directory_path="yolo/labels", data_yaml_path="yolo/data.yaml")
lorry.as_coco(images_directory_path="coco/images", annotations_path="coco/labels.json")
read = {
    "YOLO": supervision.DetectionDataset.from_yolo("yolo/images", "yolo/labels", "yolo/data.yaml", force_masks=True),
    "COCO": supervision.DetectionDataset.from_coco("coco/images", "coco/labels.json", force_masks=True),
}
pixels = {name: next(iter(found.annotations.values())).mask.sum(axis=(1, 2)).tolist() for name, found in read.items()}
print("pixels of each lorry:", pixels)
assert sorted(pixels["YOLO"]) == [80, 200] and pixels["COCO"] == [280]
uneven = dataset(supervision.Detections(xyxy=np.array([[5.25, 6.5, 20.75, 30.5]]), class_id=np.array([0])))
uneven.as_pascal_voc(images_directory_path="voc/images", annotations_directory_path="voc/labels")
uneven = next(iter(supervision.DetectionDataset.from_pascal_voc("voc/images", "voc/labels").annotations.values())).xyxy
print("by VOC:", uneven.tolist())
assert uneven.tolist() == [[5, 7, 21, 30]]
PYTHON
