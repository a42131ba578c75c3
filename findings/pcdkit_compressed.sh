#!/usr/bin/env bash
# A lidar revolution, x, y, z and reflectivity, is saved with pcdkit as .pcd in each of the three forms, and read with pcdkit and with pypcd4.
# Guess: the same points six times. Seen with pcdkit 0.2.14 and pypcd4 1.5.1 on 2026-11-30, without a word: in the forms `ascii` and `binary`, yes. In
# `binary_compressed` there are as many points as before, and other ones: x of the second is y of the first. pcdkit writes point by point what the form has
# field by field (all x, then all y, ...), and itself reads so. Reflectivity 0 to 255 beside is bytes of coordinates. What PCL or pypcd4 have written it reads well
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check pcdkit==0.2.14 pypcd4==1.5.1 python-neo-lzf==0.3.5 numba==0.68.1 numpy==2.4.6 2>/dev/null
cat > clouds.py <<'PYTHON'
import numpy as np
import pcdkit
from pypcd4 import Encoding, PointCloud

NAMES = ("x", "y", "z", "reflectivity")
random = np.random.default_rng(0)
angles, ranges_m, heights_m = np.linspace(-np.pi, np.pi, 3000), random.uniform(3, 40, 3000), random.uniform(-2, 4, 3000)
cloud = np.zeros(3000, [("x", "f4"), ("y", "f4"), ("z", "f4"), ("reflectivity", "u1")])
cloud["x"], cloud["y"], cloud["z"] = ranges_m * np.cos(angles), ranges_m * np.sin(angles), heights_m
cloud["reflectivity"] = random.integers(0, 100, 3000)

for form in ("ascii", "binary", "binary_compressed"):
    pcdkit.from_array(cloud).save("cloud.pcd", form)
    read = {"pcdkit": pcdkit.load_pcd_from_path("cloud.pcd").pc_data, "pypcd4": PointCloud.from_path("cloud.pcd").pc_data}
    for reader, found in read.items():
        same = {name: round(float(np.isclose(found[name], cloud[name]).mean()), 2) for name in NAMES}
        print(f"{form}, {reader}: {len(found)} points, right: {same}")
        assert len(found) == 3000
        assert all(share < 0.05 for share in same.values()) if form == "binary_compressed" else set(same.values()) == {1}

metres = cloud[["x", "y", "z"]].copy()
pcdkit.from_array(np.array(metres.tolist(), [("x", "f4"), ("y", "f4"), ("z", "f4")])).save("cloud.pcd", "binary_compressed")
mixed = pcdkit.load_pcd_from_path("cloud.pcd").pc_data
print("the first two were", metres[:2], "and are", mixed[:2])
assert mixed["x"][:3].tolist() == list(metres[0].tolist())

PointCloud.from_points([cloud[name] for name in NAMES], list(NAMES), [np.float32] * 3 + [np.uint8]).save("cloud.pcd", encoding=Encoding.BINARY_COMPRESSED)
assert all(np.array_equal(pcdkit.load_pcd_from_path("cloud.pcd").pc_data[name], cloud[name]) for name in NAMES)
PYTHON
venv/bin/python clouds.py 2> said.txt || { tail -5 said.txt; exit 1; }
if grep -i warn said.txt; then exit 1; fi
