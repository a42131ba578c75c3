#!/usr/bin/env bash
# View of Delft has a pose of the camera in UTM for each frame, with all digits. Where does its devkit put a car that is labelled?
# Guess: where it is, to the centimetre, as its labels are. Seen with vod-tudelft 1.0.3 on 2026-11-29: poses become float32, in which numbers
# of five million, as northings of Delft are, have steps of 0.5 m (eastings: 3 cm). Without a word, a vehicle that drives north at 1 m/s
# stands still for five frames, and then leaps; the matrix back, made by inverting that one, is off by as much. Poses in its own map frame, whose
# numbers are small, are well.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check vod-tudelft==1.0.3 numpy==2.2.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import json
from pathlib import Path

import numpy as np
from vod.configuration import KittiLocations
from vod.frame import FrameDataLoader, FrameTransformMatrix

EASTING, NORTHING = 594321.27, 5762345.11
locations = KittiLocations(root_dir=".", output_dir="out")
Path(locations.pose_dir).mkdir(parents=True)


def pose(north):
    """Return the pose of the camera, which looks north, as in the dataset: from the camera into the named frame."""
    return np.array([[1.0, 0, 0, EASTING], [0, 0, 1, NORTHING + north], [0, -1, 0, 1.5], [0, 0, 0, 1]])


true, seen, local = [], [], []
for number in range(11):
    north = 0.1 * number
    at = pose(north)
    inverse_of_local = pose(north) - [[0, 0, 0, EASTING], [0, 0, 0, NORTHING], [0] * 4, [0] * 4]
    lines = [{"odomToCamera": inverse_of_local.ravel().tolist()}, {"mapToCamera": inverse_of_local.ravel().tolist()}]
    lines.append({"UTMToCamera": at.ravel().tolist()})
    name = f"{number:05}"
    Path(locations.pose_dir, f"{name}.json").write_text("\n".join(map(json.dumps, lines)))
    matrices = FrameTransformMatrix(FrameDataLoader(locations, name))
    true.append(north)
    seen.append(round(float(matrices.t_utm_camera[1, 3]) - NORTHING, 2))
    local.append(round(float(matrices.t_map_camera[1, 3]), 2))
print("driven:", [round(north, 1) for north in true], "\nUTM:", seen, "\nmap:", local)
assert np.allclose(local, true, atol=0.01)
assert np.allclose(np.unique(np.diff(seen).round(2)), [0, 0.5])
assert matrices.t_utm_camera.dtype == np.float32
PYTHON
