#!/usr/bin/env bash
# A lorry, 2 x 10 m, heads north-east (yaw 45 degrees). A detector finds it 2 m too far ahead, another one 2 m too far to the left. What are
# overlap (IoU) and average precision, by the evaluation that comes with the devkit of Lyft's dataset ("for the data in nuScenes format")?
# Guess: 8 m of 12 m, 0.67, and a hit for the first; none for the second, which lies beside the lorry.
# Seen with lyft-dataset-sdk 0.0.8 on 2026-11-29, without a word: the other way round. The first has an overlap of 0 and an average precision
# of 0, the second 0.67 and 1. Corners are computed with the sine that stands at [0, 1] of the rotation matrix, which has a minus: each
# box is turned by -yaw about its own centre, while the centres lie where they are. Along the axes, at 0 and 90 degrees, and where a box
# is found exactly, nothing of it shows.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check numpy==2.4.6 pyquaternion==0.9.9 shapely==2.0.7
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check --no-deps lyft-dataset-sdk==0.0.8
"$folder/venv/bin/python" - <<'PYTHON'
import numpy as np
from lyft_dataset_sdk.eval.detection.mAP_evaluation import Box3D, recall_precision
from pyquaternion import Quaternion
from shapely import affinity
from shapely.geometry import box as rectangle

WIDTH_M, LENGTH_M, OFF_M = 2.0, 10.0, 2.0


def lorry(yaw_deg, ahead_m=0.0, left_m=0.0):
    """Return a box as this evaluation takes it, so far ahead and to the left in its own frame."""
    yaw = np.radians(yaw_deg)
    x_m, y_m = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]) @ [ahead_m, left_m]
    rotation = list(Quaternion(axis=[0, 0, 1], degrees=yaw_deg))
    return {
        "sample_token": "one", "name": "truck", "score": 1.0, "size": [WIDTH_M, LENGTH_M, 3.0], "rotation": rotation,
        "translation": [500 + x_m, 700 + y_m, 1.5],
    }  # fmt: skip


def overlap(yaw_deg, one, other):
    """Return the IoU of two boxes, by shapely alone."""
    first, second = (
        affinity.translate(affinity.rotate(rectangle(-LENGTH_M / 2, -WIDTH_M / 2, LENGTH_M / 2, WIDTH_M / 2), yaw_deg), *at["translation"][:2])
        for at in (one, other)
    )
    return first.intersection(second).area / first.union(second).area


seen = {}
for yaw_deg in (0, 45, 90):
    truth = lorry(yaw_deg)
    for where, found in {"exact": lorry(yaw_deg), "ahead": lorry(yaw_deg, OFF_M), "left": lorry(yaw_deg, 0, OFF_M)}.items():
        iou, right = Box3D(**truth).get_iou(Box3D(**found)), overlap(yaw_deg, truth, found)
        precision = recall_precision([truth], [found], 0.5)[2]
        seen[yaw_deg, where] = round(float(iou), 3), float(precision), round(right, 3)
        print(f"yaw {yaw_deg:2}, {where}: IoU {iou:.3f}, average precision {precision:.1f}; by shapely {right:.3f}")
HIT, MISS = (0.667, 1, 0.667), (0, 0, 0)
for yaw_deg in (0, 90):
    assert seen[yaw_deg, "ahead"] == HIT and seen[yaw_deg, "left"] == MISS
assert seen[45, "exact"] == (1, 1, 1)
assert seen[45, "ahead"] == (0, 0, 0.667) and seen[45, "left"] == (0.667, 1, 0)
PYTHON
