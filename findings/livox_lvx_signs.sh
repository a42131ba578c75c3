#!/usr/bin/env bash
# A Livox Mid-40 looks at a wall, 5 m ahead and 4 m wide, and Livox Viewer records it as .lvx. Where is the wall, by livox-lvx, whose fields say "mm"?
# Guess: there. Seen with livox-lvx 0.2.1 on 2026-11-30: whatever is to the right or below, so three of four points, is 4,295 km to the left or above. Signed
# coordinates are read as unsigned ones: -1 mm is 4294967295, for each kind of Cartesian points. Ranges and angles (kinds 1, 3 and 5) are well
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check livox-lvx==0.2.1 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import struct

import numpy as np
from lvx.lvx import LvxFileReader

RAW, EXTENDED = 0, 2
wall = np.stack(np.broadcast_arrays(5000, np.repeat(np.linspace(-2000, 2000, 20), 20).round(), np.tile(np.linspace(-1000, 1000, 20), 20).round()), 1).astype(int)


def recording(kind, per_package):
    """Return a recording of one frame, which holds the points of the wall as far as they fill packages of that kind."""
    device = struct.pack("<16s16s3B6f", b"0TFDH7600600000", bytes(16), 0, 1, 0, *[0.0] * 6)
    packages = b""
    for at in range(0, len(wall) - per_package + 1, per_package):
        packages += struct.pack("<5BI2BQ", 0, 5, 1, 1, 0, 0, 0, kind, at * 10_000)
        packages += b"".join(struct.pack("<3iB", *point, 50) + bytes(kind == EXTENDED) for point in wall[at : at + per_package])
    header = struct.pack("<16s4BI", b"livox_tech", 1, 1, 0, 0, 0xAC0EA767) + struct.pack("<IB", 50, 1) + device
    return header + struct.pack("<3Q", len(header), len(header) + 24 + len(packages), 0) + packages


for name, kind, per_package in (("raw", RAW, 100), ("extended", EXTENDED, 96)):
    with open("wall.lvx", "wb") as file:
        file.write(recording(kind, per_package))
    with open("wall.lvx", "rb") as file:
        points = np.array([(point.x, point.y, point.z) for frame in LvxFileReader(file) for package in frame.packages for point in package.points])
    true = wall[: len(points)]
    far = (points > 4e9).any(1)
    print(f"{name}: {len(points)} points, {far.mean():.0%} of them far off: {true[0]} mm is {points[0]}; the mean is {points.mean(0) / 1e6} km off the sensor")
    assert np.array_equal(far, (true < 0).any(1)) and 0.7 < far.mean() < 0.8
    assert np.array_equal(points.astype(np.uint32).view(np.int32), true)
PYTHON
