#!/usr/bin/env bash
# A box in Label Studio is turned by 90 degrees about its corner: of a lorry, 160 x 90 pixels in an image of 1600 x 900. It then covers
# 90 x 160 pixels to the left of that corner. What do the exporters write? Guess: the box around it, or its four corners.
# Seen with label-studio-sdk 2.1.2 on 2026-11-28: three exports hold three different places, of which one is right, without a word.
#   YOLO OBB     the four corners: right
#   COCO         turned in per cent of width and height, as if the image were square: 160 x 90 pixels, 70 too far to the left
#   YOLO, VOC    not turned at all: 160 x 90 pixels to the right of the corner, where there is no lorry
# Of a box turned by 30 degrees, COCO's is 219 x 123 pixels where 184 x 158 are right.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check label-studio-sdk==2.1.2 pillow==13.0.0 numpy==2.2.6
cd "$folder"
venv/bin/python - 2>errors.txt <<'PYTHON' || { tail -5 errors.txt; exit 1; }
import json
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from label_studio_sdk.converter import Converter
from PIL import Image

SIZE = np.array([1600, 900])
CORNER, LONG, HIGH = np.array([800.0, 450.0]), 160.0, 90.0
LAYOUT = (
    '<View><Image name="image" value="$image"/>'
    '<RectangleLabels name="label" toName="image"><Label value="lorry"/></RectangleLabels></View>'
)


def around(degrees):
    """Return x, y, width, height of the box around the rectangle, turned clockwise in the image, about its corner."""
    cosine, sine = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    sides = np.array([[0, 0], [LONG, 0], [LONG, HIGH], [0, HIGH]])
    corners = CORNER + sides @ np.array([[cosine, sine], [-sine, cosine]])
    low = corners.min(axis=0)
    return [*low, *(corners.max(axis=0) - low)]


tasks = []
for degrees in (0, 30, 90):
    Image.new("RGB", tuple(SIZE)).save(f"{degrees}.png")
    x, y = 100 * CORNER / SIZE
    value = {"x": x, "y": y, "width": 100 * LONG / SIZE[0], "height": 100 * HIGH / SIZE[1]}
    value |= {"rotation": degrees, "rectanglelabels": ["lorry"]}
    result = {"id": "1", "type": "rectanglelabels", "from_name": "label", "to_name": "image", "value": value}
    result |= {"original_width": int(SIZE[0]), "original_height": int(SIZE[1])}
    image = str(Path(f"{degrees}.png").resolve())
    tasks.append({"id": degrees, "data": {"image": image}, "annotations": [{"id": 1, "result": [result]}]})
Path("tasks.json").write_text(json.dumps(tasks))
converter = Converter(LAYOUT, ".", download_resources=False)
converter.convert_to_coco("tasks.json", "coco", is_dir=False)
converter.convert_to_yolo("tasks.json", "yolo", is_dir=False)
converter.convert_to_yolo("tasks.json", "obb", is_dir=False, is_obb=True)
converter.convert_to_voc("tasks.json", "voc", is_dir=False)

coco = [annotation["bbox"] for annotation in json.loads(Path("coco/result.json").read_text())["annotations"]]
for number, degrees in enumerate((0, 30, 90)):
    right = around(degrees)
    corners = np.loadtxt(f"obb/labels/{degrees}.txt")[1:].reshape(4, 2) * SIZE
    obb = [*corners.min(axis=0), *np.ptp(corners, axis=0)]
    x, y, width, height = np.loadtxt(f"yolo/labels/{degrees}.txt")[1:] * np.tile(SIZE, 2)
    yolo = [x - width / 2, y - height / 2, width, height]
    bounds = ElementTree.parse(f"voc/Annotations/{degrees}.xml").find(".//bndbox")
    left, top, end, bottom = (float(bounds.find(name).text) for name in ("xmin", "ymin", "xmax", "ymax"))
    voc = [left, top, end - left, bottom - top]
    seen = {"right": right, "OBB": obb, "COCO": coco[number], "YOLO": yolo, "VOC": voc}
    print(degrees, "degrees:", {name: np.round(box).astype(int).tolist() for name, box in seen.items()})
    assert np.allclose(obb, right)
    assert np.allclose(yolo, around(0))
    assert np.allclose(voc, around(0))
    assert np.allclose(coco[number], right) == (degrees == 0)
assert np.allclose(coco[2], [640, 450, 160, 90])
assert np.allclose(coco[1][2:], [218.56, 122.94], atol=0.01)
PYTHON
