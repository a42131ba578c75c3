#!/usr/bin/env bash
# A car, 4.2 m long, 1.8 wide, 1.5 high, turned to the left by 0.3 rad, is labelled in the raw format of KITTI (tracklet_labels.xml). Its labels are converted with Datumaro
# for Supervisely, to be looked at and mended there. Guess: the same box there, which has its centre, and its dimensions along its own x, y and z.
# Seen with datumaro 1.13.12 on 2026-11-29, without a word:
# - a box 1.5 m long, 1.8 wide and 4.2 HIGH: KITTI has height, width, length, in this order, and Datumaro takes them for x, y, z
# - it is 0.75 m too low: tz is that of the bottom for KITTI's own development kit, and becomes the centre
# Back to KITTI both undo themselves, so that going there and back shows nothing of it; what was labelled in Supervisely is wrong in KITTI in turn.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check datumaro==1.13.12
cd "$folder"
mkdir -p kitti/velodyne_points/data
cat >kitti/tracklet_labels.xml <<'XML'
<?xml version="1.0" encoding="UTF-8" standalone="yes"?>
<boost_serialization signature="serialization::archive" version="9"><tracklets class_id="0" tracking_level="0" version="0">
  <count>1</count><item_version>1</item_version>
  <item class_id="1" tracking_level="0" version="1"><objectType>Car</objectType><h>1.5</h><w>1.8</w><l>4.2</l><first_frame>0</first_frame>
    <poses class_id="2" tracking_level="0" version="0"><count>1</count><item_version>2</item_version>
      <item class_id="3" tracking_level="0" version="2"><tx>20</tx><ty>3</ty><tz>-1.7</tz><rx>0</rx><ry>0</ry><rz>0.3</rz>
        <state>2</state><occlusion>0</occlusion><occlusion_kf>1</occlusion_kf><truncation>0</truncation>
        <amt_occlusion>-1</amt_occlusion><amt_occlusion_kf>-1</amt_occlusion_kf><amt_border_l>-1</amt_border_l><amt_border_r>-1</amt_border_r>
        <amt_border_kf>-1</amt_border_kf></item></poses><finished>1</finished></item>
</tracklets></boost_serialization>
XML
cat >points.pcd <<'PCD'
VERSION .7
FIELDS x y z
SIZE 4 4 4
TYPE F F F
COUNT 1 1 1
WIDTH 1
HEIGHT 1
VIEWPOINT 0 0 0 1 0 0 0
POINTS 1
DATA ascii
20 3 -1
PCD
cp points.pcd kitti/velodyne_points/data/0000000000.pcd
venv/bin/python -W ignore - <<'PYTHON'
import json
from pathlib import Path

from datumaro import Dataset

labels = Dataset.import_from("kitti", "kitti_raw")
labels.export("supervisely", "sly_pointcloud", save_media=True)
((path,),) = [list(Path("supervisely").rglob("*.pcd.json"))]
geometry = json.loads(path.read_text())["figures"][0]["geometry"]
print(geometry)
assert geometry["dimensions"] == {"x": 1.5, "y": 1.8, "z": 4.2}
assert geometry["position"] == {"x": 20, "y": 3, "z": -1.7} and geometry["rotation"]["z"] == 0.3
Dataset.import_from("supervisely", "sly_pointcloud").export("back", "kitti_raw", save_media=True)
back = Path("back/tracklet_labels.xml").read_text()
print("and back:", [part for part in back.split() if part.startswith(("<h>", "<w>", "<l>", "<tz>"))])
assert "<h>1.5</h>" in back and "<l>4.2</l>" in back and "<tz>-1.7</tz>" in back
PYTHON
