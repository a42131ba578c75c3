#!/usr/bin/env bash
# A camera on a wrist sees a table that is tilted by a few degrees, and comes nearer. Its depth images, metres as float32 or millimetres as uint16, become normal maps for a policy with
# depth2normal, as it is set up: `--range auto`, which "stays consistent across the frames of a sequence". Guess: the same normals in each frame, as it is one table.
# Seen with depth2normal 2.0.1 on 2026-11-30, without a word:
# - metres: as long as one pixel of the frame is farther than 1 m, the table is flat (z of the normal 0.99); else it is a cliff (0.25), as depths up to 1 are multiplied by 255
# - millimetres: flat as well, or a cliff once no pixel is farther than 255 mm: larger numbers are divided by 257, while those up to 255 are taken for 8 bits
# What to divide by is decided frame by frame, by the farthest pixel alone.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check depth2normal==2.0.1 numpy==2.4.6 pillow==12.3.0 2>/dev/null
venv/bin/python -W error - <<'PYTHON'
import numpy as np
from depth2normal import depth_to_normal, rescale_depth

assert "stays consistent across the" in rescale_depth.__doc__
SLOPE_M = 0.015  # from one pixel to the next, so that a row of 20 pixels rises by 0.3 m


def table(farthest_m):
    return np.tile(farthest_m - SLOPE_M * np.arange(20)[::-1], (20, 1))


def upright(depth):
    """Return z of the normal in the middle of the image."""
    return round(float(depth_to_normal(depth)[10, 10, 2]) / 255 * 2 - 1, 2)


metres = {farthest_m: upright(table(farthest_m).astype(np.float32)) for farthest_m in (1.2, 1.05, 0.99, 0.8)}
near = np.tile(np.arange(200, 255, 2, dtype=np.uint16), (20, 1))
steps_mm = {far_mm: upright(near + np.uint16(far_mm - 254)) for far_mm in (300, 260, 254)}
print("farthest pixel in metres: z of the normal", metres)
print("in millimetres, 2 mm a pixel", steps_mm)
assert metres[1.2] == metres[1.05] > 0.98 and metres[0.99] == metres[0.8] < 0.3
assert steps_mm[300] == steps_mm[260] > 0.98 and steps_mm[254] < 0.5
one_far = table(0.8).astype(np.float32)
one_far[0, 0] = 3
print("one pixel at 3 m, the rest nearer than 0.8 m:", upright(one_far))
assert upright(one_far) > 0.98
PYTHON
