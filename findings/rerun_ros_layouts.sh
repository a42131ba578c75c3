#!/usr/bin/env bash
# A ROS 2 recording uses what its messages have fields for: a camera with a region of interest and binning, clouds with padded rows, numbers
# in big-endian order, a receiver without a fix (status -1). What does rerun's importer of MCAP make of it?
# Guess: fields that change the meaning of others are used, or a warning tells. Seen with rerun-sdk 0.41.0 on 2026-11-28, without a word:
# - CameraInfo: K and size are those of the full image; `roi` and `binning` do not count, though the images are 160x120 in place of
#   640x480: projected points are off by the region, and four times too far apart
# - PointCloud2: `row_step` does not count, so that the padding of each row becomes points (6 of 4); big-endian ones are right
# - Image: big-endian depth is not swapped, so that 1500 mm become 56325; its padded rows are right
# - NavSatFix without a fix: a point on the map, at the latitude and longitude 0 that the receiver sends
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check rerun-sdk==0.41.0 rosbags==0.11.9 numpy==2.4.6
cd "$folder"
export HOME="$folder"
venv/bin/python - <<'PYTHON'
from pathlib import Path

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

store = get_typestore(Stores.ROS2_HUMBLE)
made = {name.rpartition("/")[2]: kind for name, kind in store.types.items()}
header = made["Header"](made["Time"](10, 0), "sensor")
region = made["RegionOfInterest"](100, 50, 240, 320, False)
k, p = np.array([500.0, 0, 320, 0, 500, 240, 0, 0, 1]), np.array([500.0, 0, 320, 0, 0, 500, 240, 0, 0, 0, 1, 0])
camera = made["CameraInfo"](header, 480, 640, "plumb_bob", np.zeros(5), k, np.eye(3).reshape(-1), p, 2, 2, region)
fields = [made["PointField"](name, 4 * number, 7, 1) for number, name in enumerate("xyz")]


def cloud(order, padding):
    rows = np.zeros((2, 2, 3), order + "f4")
    rows[:, :, 0] = [[1, 2], [3, 4]]
    data = np.frombuffer(b"".join(row.tobytes() + bytes(padding) for row in rows), np.uint8)
    return made["PointCloud2"](header, 2, 2, fields, order == ">", 12, 24 + padding, data, True)


depth = np.full(16, 1500, ">u2").view(np.uint8)
messages = {
    "/camera_info": camera,
    "/cloud_padded": cloud("<", 12),
    "/cloud_big": cloud(">", 0),
    "/depth_big": made["Image"](header, 4, 4, "16UC1", 1, 8, depth),
    "/no_fix": made["NavSatFix"](header, made["NavSatStatus"](-1, 1), 0.0, 0.0, 0.0, np.zeros(9), 0),
}
with Writer(Path("drive"), version=9, storage_plugin=StoragePlugin.MCAP) as writer:
    for topic, message in messages.items():
        kind = message.__msgtype__
        writer.write(writer.add_connection(topic, kind, typestore=store), 1, store.serialize_cdr(message, kind))
PYTHON
venv/bin/rerun mcap convert drive/drive.mcap -o drive.rrd >log 2>&1
venv/bin/rerun rrd print -vvv drive.rrd >printed 2>>log
venv/bin/python - <<'PYTHON'
import json
import re
from pathlib import Path

found, entity, names = {}, "", []
for line in Path("printed").read_text().splitlines():
    if named := re.search(r"entity_path: (\S+)", line):
        entity = named[1]
    cells = [cell.strip(" │") for cell in line.split("┆")]
    if cells[0] == "RowId":
        names = cells
    elif cells[0].startswith("row_"):
        found |= {(entity, name): cell for name, cell in zip(names, cells)}
matrix = json.loads(found["/camera_info", "Pinhole:image_from_camera"])[0]
size = json.loads(found["/camera_info", "Pinhole:resolution"])[0]
buffer = found["/depth_big", "DepthImage:buffer"]
padded, big = (
    [float(x) for x in re.findall(r"\[([\d.]+), ", found[topic, "Points3D:positions"])]  # long lists end in "…"
    for topic in ("/cloud_padded", "/cloud_big")
)
place = json.loads(found["/no_fix", "GeoPoints:positions"])[0]
print(f"camera {matrix} {size}; padded {padded}; big-endian {big}; depth {buffer[:20]}; without a fix {place}")
assert (matrix, size) == ([500, 0, 0, 0, 500, 0, 320, 240, 1], [640, 480])
assert padded == [1, 2, 0, 3, 4, 0]
assert big == [1, 2, 3, 4]
assert buffer.startswith("[[5, 220, 5, 220")  # little-endian: 56325
assert place == [0, 0]
PYTHON
