#!/usr/bin/env bash
# Lorries are labelled with turned boxes in pictures of 1600 x 900, for a detector that wants squares of 640: torchvision resizes picture and boxes (`v2.Resize((640, 640))`,
# `BoundingBoxes` of the format CXCYWHR, or XYXYXYXY, the four corners), and what the detector finds is resized back. A lorry is 400 x 100 pixels, turned by 30 degrees.
# Guess: squashed, its corners are those of the picture; as a rectangle, which a squashed one is not, one of the same place and about the same area; and back it is as it was.
# Seen with torchvision 0.29.1 and torch 2.14.1 on 2026-11-30, without a word: 521 x 100 when it is back, for a detector without any error, which is an overlap of 0.77; between 0 and
# 90 degrees all are longer than they were. What is made of a squashed box is the rectangle through the two corners that are farthest apart, here 15 % larger than the lorry, and again
# when it is stretched; after another time it is 643 long. The corners, which would be right, are made so, too. Resized in proportion, boxes stay as they are
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check torch==2.14.1 torchvision==0.29.1 shapely==2.1.2 numpy==2.4.6
venv/bin/python - <<'PYTHON'
import numpy as np
import torch
from shapely import Polygon
from torchvision.ops import box_convert
from torchvision.transforms import v2
from torchvision.tv_tensors import BoundingBoxes

PICTURE, SQUARE = (900, 1600), (640, 640)  # heights and widths
LENGTHS_PX = {0: 400, 10: 469.4, 30: 521.5, 45: 503.9, 60: 471.4, 80: 423.9, 90: 400}  # seen, by degrees


def corners(box):
    if str(box.format).endswith("CXCYWHR"):
        box = box_convert(box.as_subclass(torch.Tensor), "cxcywhr", "xyxyxyxy")
    return box.as_subclass(torch.Tensor).numpy().reshape(4, 2).astype(float)


def label(degrees, form="CXCYWHR"):
    box = torch.tensor([[800.0, 450, 400, 100, degrees]])
    if form == "XYXYXYXY":
        box = box_convert(box, "cxcywhr", "xyxyxyxy")
    return BoundingBoxes(box, format=form, canvas_size=PICTURE)


for degrees, expected_px in LENGTHS_PX.items():
    back = v2.Resize(PICTURE)(v2.Resize(SQUARE)(label(degrees)))
    x, y, length_px, width_px, turned = back[0].tolist()
    here, there = Polygon(corners(label(degrees))), Polygon(corners(back))
    print(f"{degrees} degrees: {length_px:.1f} x {width_px:.1f}, turned by {turned:.1f}, overlap {here.intersection(there).area / here.union(there).area:.2f}")
    assert np.allclose([x, y, length_px, width_px, turned], [800, 450, expected_px, 100, degrees], atol=0.1)

squash = np.array(SQUARE[::-1]) / np.array(PICTURE[::-1])
real = Polygon(corners(label(30)) * squash)
for form in ("CXCYWHR", "XYXYXYXY"):
    found = Polygon(corners(v2.Resize(SQUARE)(label(30, form))))
    print(f"{form}: area {found.area / real.area:.2f} times the lorry's, overlap {found.intersection(real).area / found.union(real).area:.2f}")
    assert np.isclose(found.area / real.area, 1.152, atol=0.002)
box = label(30)
for _ in range(2):
    box = v2.Resize(PICTURE)(v2.Resize(SQUARE)(box))
in_proportion = v2.Resize((450, 800))(label(30))
print(f"there and back twice: {box[0, 2].item():.1f} long; in proportion {in_proportion[0].tolist()}")
assert np.isclose(box[0, 2].item(), 643, atol=0.5) and np.allclose(in_proportion[0], [400, 225, 200, 50, 30], atol=0.01)
PYTHON
