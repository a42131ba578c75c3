#!/usr/bin/env bash
# An image is labelled in CVAT for a gripper: a mug and a pan, each with two keypoints (handle, rim) and a box, grouped as CVAT groups what belongs together; the mug is
# group 1, the pan group 2, as CVAT counts groups. The XML becomes COCO keypoints with airo-dataset-tools. Guess: two objects.
# Seen with airo-dataset-tools 2026.10.1 on 2026-11-30, without a word: THREE, as there are taken to be as many pans as the number of the pan's group, 2. The first pan
# is the mug: its keypoints, its box, labelled "pan". An object's number is looked for among all categories, so where both categories count from 1, the pan is at the
# place of the mug and is nowhere else. Of keypoints that have no name in common, those of the additional pan are all (0, 0, 0), which is refused.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check airo-dataset-tools==2026.10.1 airo-spatial-algebra==2026.10.1 airo-typing==2026.10.1 \
  pydantic==2.14.4 numpy==2.4.6
cd "$folder"
venv/bin/python -W ignore - 2>/dev/null <<'PYTHON'
import json

from airo_dataset_tools.cvat_labeling.convert_cvat_to_coco import cvat_image_to_coco

MUG = {"handle": (100, 100), "rim": (110, 90)}, (90, 80, 130, 120)
PAN = {"handle": (400, 300), "rim": (450, 310)}, (380, 280, 500, 340)


def image(number, mug_group, pan_group, names=("handle", "rim")):
    """Return an image with a mug and a pan; `names` are those of the pan's keypoints."""
    shapes = ""
    for category, group, (points, box) in (("mug", mug_group, MUG), ("pan", pan_group, PAN)):
        shown = points if category == "mug" else dict(zip(names, points.values(), strict=True))
        rest = f'source="manual" occluded="0" z_order="0" group_id="{group}"'
        for name, (x, y) in shown.items():
            shapes += f'<points label="{category}.{name}" points="{x:.2f},{y:.2f}" {rest}></points>'
        sides = " ".join(f'{side}="{value:.2f}"' for side, value in zip(("xtl", "ytl", "xbr", "ybr"), box, strict=True))
        shapes += f'<box label="{category}.bbox" {sides} {rest}></box>'
    return f'<image id="{number}" name="{number}.png" width="640" height="480">{shapes}</image>'


def objects(mug_group, pan_group, names=("handle", "rim")):
    """Return category, keypoints and box (x, y, width, height) of each object in the first of two alike images."""
    labels = [f"mug.{name}" for name in (*MUG[0], "bbox")] + [f"pan.{name}" for name in (*names, "bbox")]
    labels = "".join(f"<label><name>{label}</name><color>#fff</color><type>any</type><attributes></attributes></label>" for label in labels)
    task = "".join(f"<{key}>0</{key}>" for key in ("id", "size", "mode", "overlap", "bugtracker", "created", "updated", "subset", "start_frame", "stop_frame"))
    task += "<frame_filter></frame_filter><segments><segment><id>0</id><start>0</start><stop>1</stop><url>u</url></segment></segments>"
    task += f"<owner><username>u</username><email>e</email></owner><assignee></assignee><labels>{labels}</labels>"
    images = "".join(image(number, mug_group, pan_group, names) for number in (0, 1))
    with open("labels.xml", "w") as file:
        file.write(f"<annotations><version>1.1</version><meta><task>{task}</task><dumped>now</dumped></meta>{images}</annotations>")
    categories = [{"id": 1, "name": "mug", "keypoints": list(MUG[0])}, {"id": 2, "name": "pan", "keypoints": list(names)}]
    with open("categories.json", "w") as file:
        json.dump({"categories": [{**each, "supercategory": "", "skeleton": []} for each in categories]}, file)
    coco = cvat_image_to_coco("labels.xml", "categories.json", add_bbox=True, add_segmentation=False)
    return [
        (("mug", "pan")[each["category_id"] - 1], list(each["keypoints"]), list(each["bbox"]))
        for each in coco["annotations"] if each["image_id"] == coco["images"][0]["id"]
    ]  # fmt: skip


mug = "mug", [100, 100, 2, 110, 90, 2], [90, 80, 40, 40]
pan = "pan", [400, 300, 2, 450, 310, 2], [380, 280, 120, 60]
wrong = "pan", *mug[1:]
for name, found in (("groups 1 and 2:", objects(1, 2)), ("both group 1:", objects(1, 1))):
    print(name, *found, sep="\n  ")
assert objects(1, 2) == [mug, wrong, pan]
assert objects(1, 1) == [mug, wrong]
try:
    objects(1, 2, ("grip", "edge"))
except ValueError as error:
    assert "max_coordinate is 0.0" in str(error)
else:
    raise AssertionError("not refused")
PYTHON
