#!/usr/bin/env bash
# A depth image in metres, of a wall at 5 to 8 m, is kept with ZFP and a tolerance of a millimetre, which HDF5 and Zarr offer as a filter, too. A pixel without a return
# is NaN, or infinite (nearer or farther than the camera measures), or 0, by the conventions that ROS has. What is read?
# Guess: NaN, infinite and 0, all else within a millimetre; or an error, if the format has no room for what is no number.
# Seen with zfpy 1.0.1.post0 on 2026-11-29, without a word:
# - NaN is 16 m, a distance like any other, behind the wall; its neighbours are right
# - infinite is -2 m, and so are the 15 pixels that share its block of 4 x 4
# - 0 is -0.00009 m: within the tolerance, but `depth == 0` and `depth > 0` no longer tell what is missing
# The same with `rate` or `precision` in place of `tolerance`, with 16 or -16 for NaN. Without any of them it is lossless, and all three come back.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check zfpy==1.0.1.post0 numpy==2.4.6
"$folder/venv/bin/python" - <<'PYTHON'
import numpy as np
import zfpy

wall_m = (5 + np.add.outer(np.linspace(0, 1, 64), np.linspace(0, 2, 64))).astype(np.float32)
for missing, options, seen_m, wrong in (
    (np.nan, {"tolerance": 0.001}, 16, 0),
    (np.nan, {"rate": 16}, -16, 0),
    (np.nan, {"precision": 20}, -16, 0),
    (np.inf, {"tolerance": 0.001}, -2, 15),
    (0.0, {"tolerance": 0.001}, 0, 0),
):
    depth_m = wall_m.copy()
    depth_m[20, 33] = missing
    read_m = zfpy.decompress_numpy(zfpy.compress_numpy(depth_m, **options))
    off = np.abs(read_m - wall_m) > 0.001
    print(f"{missing} with {options}: {read_m[20, 33]:.5f} m, and {off.sum() - 1} neighbours are wrong")
    assert np.isclose(read_m[20, 33], seen_m, atol=0.001) and read_m[20, 33] != missing
    assert off[20, 33] and off.sum() - 1 == wrong and not off[:20].any()
    assert np.array_equal(zfpy.decompress_numpy(zfpy.compress_numpy(depth_m)), depth_m, equal_nan=True)
PYTHON
