#!/usr/bin/env bash
# A measurement (MF4) has the speed every second, and heading, gear and brake from 5 s on, when their bus woke up. asammdf makes a table of it.
# What are gear and heading at 1 s, and the heading at 6 s, between 359 degrees at 5 s and 1 degree at 6.5 s?
# Guess: nothing (NaN) at 1 s, as nothing was measured yet; at 6 s the latest, 359.
# Seen with asammdf 8.8.28 on 2026-11-29, as it is set up (`use_interpolation=True`), without a word:
# - each channel has the value of its FIRST sample before it, and of its last one behind it: gear 1 and 359 degrees from 0 s on
# - at 6 s the heading is 120.3 degrees: floats lie on the line between their neighbours, integers (gear) are held, so that in one row some
#   signals of a message are of 5 s, and others of no time at all
# - `cut(stop=7.2)` adds a sample at 7.2 s, with a heading that no one measured (3.4), unless `include_ends=False`
# With `use_interpolation=False` there is NaN wherever a raster has no sample of its own.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check asammdf==8.8.28 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import numpy as np
from asammdf import MDF, Signal

late_s = np.array([5.0, 6.5, 7.0, 8.0])
mdf = MDF(version="4.10")
mdf.append([Signal(np.arange(10.0), np.arange(10.0), name="speed")])
mdf.append(
    [
        Signal(np.array([359.0, 1.0, 3.0, 5.0]), late_s, name="heading"),
        Signal(np.array([1, 2, 5, 7], np.uint8), late_s, name="gear"),
    ]
)
mdf.save("drive.mf4")
mdf = MDF("drive.mf4")
table, gaps, cut = mdf.to_dataframe(raster=1.0), mdf.to_dataframe(raster=1.0, use_interpolation=False), mdf.cut(start=3, stop=7.2)
print(table)
print(f"cut: {cut.get('heading').timestamps} s, {cut.get('heading').samples.round(1)} degrees")
assert table.gear.tolist() == [1] * 7 + [5, 7, 7]
assert np.allclose(table.heading, [359] * 6 + [359 - 358 / 1.5, 3, 5, 5])
assert gaps.gear.isna().tolist() == [second not in (5, 7, 8) for second in range(10)]
assert cut.get("heading").timestamps.tolist() == [5.0, 6.5, 7.0, 7.2]
assert np.allclose(cut.get("heading").samples, [359, 1, 3, 3.4])
assert mdf.cut(start=3, stop=7.2, include_ends=False).get("heading").timestamps.tolist() == [5.0, 6.5, 7.0]
PYTHON
