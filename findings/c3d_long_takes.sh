#!/usr/bin/env bash
# A motion capture system follows a robot for 700 s at 100 Hz, as ground truth; in one frame it loses the marker (NaN). The take, 70,000 frames, is written as
# C3D with ezc3d, and read with ezc3d and with c3d. Guess: 70,000 frames in both, of which one has no position; or an error, if the format has no room.
# Seen with ezc3d 1.7.2 and c3d 0.6.0 beside numpy 2.4.6 on 2026-11-29:
# - ezc3d writes all of them and reads 65,535, without a word: the header counts frames in 16 bits, and its parameter POINT:FRAMES, which has
#   room, says 65535 as well
# - c3d reads NONE of them: its last frame, 65535, plus 1 is 0 for NumPy. It warns of an overflow, and of bytes that were left. From 65,535 frames on
#   it is so, and 65,534 are well
# - the lost marker is NaN for ezc3d, and for c3d it is at (0, 0, 0), where the origin of the room is; a fourth number of -1 tells
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check ezc3d==1.7.2 c3d==0.6.0 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import warnings
from pathlib import Path

import c3d
import ezc3d
import numpy as np

LOST = 2


def read(frames):
    """Write a take of so many frames, and return what each library reads of it, and what was said."""
    take = ezc3d.c3d()
    take["parameters"]["POINT"]["RATE"]["value"] = [100]
    take["parameters"]["POINT"]["LABELS"]["value"] = ("robot",)
    take["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    points_mm = np.full((4, 1, frames), 500.0)
    points_mm[0, 0] = np.arange(frames)
    points_mm[:3, 0, LOST] = np.nan
    take["data"]["points"] = points_mm
    take.write("take.c3d")
    with warnings.catch_warnings(record=True) as said, Path("take.c3d").open("rb") as file:
        warnings.simplefilter("always")
        rows = [points[0, :4] for _, points, _ in c3d.Reader(file).read_frames()]
    return ezc3d.c3d("take.c3d"), rows, [str(each.message) for each in said if "nalog" not in str(each.message)]


for frames, by_ezc3d, by_c3d in ((65_534, 65_534, 65_534), (65_535, 65_535, 0), (70_000, 65_535, 0)):
    take, rows, said = read(frames)
    points_mm = take["data"]["points"][:3, 0]
    print(f"{frames} frames written: {points_mm.shape[1]} read by ezc3d, {len(rows)} by c3d, which says {said}")
    assert (points_mm.shape[1], len(rows)) == (by_ezc3d, by_c3d) and np.isnan(points_mm[:, LOST]).all()
    assert bool(said) == (not rows)
    assert Path("take.c3d").stat().st_size > frames * 16 and take["parameters"]["POINT"]["FRAMES"]["value"][0] == by_ezc3d
    if rows:
        print(f"the lost marker for c3d: {rows[LOST].tolist()}")
        assert rows[LOST].tolist() == [0, 0, 0, -1]
PYTHON
