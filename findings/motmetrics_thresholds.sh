#!/usr/bin/env bash
# Tracks are evaluated with motmetrics, whose `iou_matrix` has a threshold, `max_iou`, here 0.7 as for cars; and they come from text files
# of the MOT benchmark, with what a track needs: frame, id, x, y, width, height. Guess: boxes that overlap by less than 0.7 do not match; a
# file without confidences is read as certain, or refused. Seen with motmetrics 1.4.0 on 2026-11-29, without a word:
# - `max_iou` is the greatest DISTANCE, 1 - IoU: with 0.7 an overlap of a third is a match, and what looks stricter, 0.9, allows a tenth
# - of a file with six columns nothing is left: confidences that are not there are NaN, and rows below the least one, -1, are taken out.
#   A tracker that finds all is one without a box, MOTA 0; with a seventh column its MOTA is 1.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check motmetrics==1.4.0 pandas==2.3.3 numpy==1.26.4
cd "$folder"
venv/bin/python - 2>errors.txt <<'PYTHON' || { tail -5 errors.txt; exit 1; }
import motmetrics
import numpy as np

LEFT, RIGHT = np.array([[0.0, 0, 20, 10]]), np.array([[10.0, 0, 20, 10]])
overlap = 1 / 3
distances = {at: float(motmetrics.distances.iou_matrix(LEFT, RIGHT, max_iou=at)[0, 0]) for at in (0.5, 0.7, 0.9)}
print(f"boxes that overlap by {overlap:.2f}, distance by max_iou:", distances)
assert np.isnan(distances[0.5])
assert np.isclose(distances[0.7], 1 - overlap)
assert np.isclose(distances[0.9], 1 - overlap)


def tracks(path, more):
    """Write and read ten frames of one box."""
    with open(path, "w") as file:
        file.writelines(f"{frame},1,{10 * frame},20,30,40{more}\n" for frame in range(1, 11))
    return motmetrics.io.loadtxt(path, fmt="mot15-2D")


def accuracy(found):
    accumulator = motmetrics.utils.compare_to_groundtruth(truth, found, "iou", distth=0.5)
    return float(motmetrics.metrics.create().compute(accumulator, metrics=["mota"])["mota"].iloc[0])


truth = tracks("truth.txt", ",1,1,1")
seen = {more: tracks(f"found{len(more)}.txt", more) for more in ("", ",1")}
print({f"{6 + len(more) // 2} columns": (len(found), accuracy(found)) for more, found in seen.items()})
assert [len(found) for found in seen.values()] == [0, 10]
assert [accuracy(found) for found in seen.values()] == [0.0, 1.0]
PYTHON
