#!/usr/bin/env bash
# Clouds are converted for labelling with pointcloudkit: a lidar sweep of nuScenes (.pcd.bin: x, y, z, intensity, ring), one of KITTI (.bin: x, y, z and an
# intensity of 0 to 1) to LAS, and a coloured cloud of PCL's, whose binary PCD has `rgb` as the bits of a float, opaque (alpha of 255) as PCL's points are.
# The coloured one is read with pypointcloud, too, with coordinates as float64, as maps have them. Guess: the same points, to a millimetre, or an error.
# Seen with pointcloudkit 0.1.0 and pypointcloud 0.1.0 on 2026-11-30, without a word:
# - nuScenes: four numbers are a point, whatever the name, so 34,688 points become 43,360, of which every fifth is right
# - LAS: coordinates are multiples of 1 cm, and each intensity below 1 is 0; of KITTI's, none is left
# - colours: of points with a red of 128 or more all are black: with the alpha, their bits are no finite number, and such become 0
# - pypointcloud: float64 is read as float32, two for each, so x and y are halves of x, and the second point is the rest of the first
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check pointcloudkit==0.1.0 pypointcloud==0.1.0 laspy==2.7.0 numpy==2.4.6 2>/dev/null
cd "$folder"
venv/bin/python -W error - <<'PYTHON'
import numpy as np
import pypointcloud
from pointcloudkit import PointCloud, convert

rng = np.random.default_rng(0)


def save_pcd(name, points):
    """Write a structured array as a binary PCD."""
    kinds = {"f": "F", "u": "U", "i": "I"}
    names, types = points.dtype.names, [points.dtype[field] for field in points.dtype.names]
    lines = ["VERSION 0.7", "FIELDS " + " ".join(names), "SIZE " + " ".join(str(kind.itemsize) for kind in types)]
    lines += ["TYPE " + " ".join(kinds[kind.kind] for kind in types), "COUNT " + " ".join("1" for _ in types), f"WIDTH {len(points)}", "HEIGHT 1"]
    lines += ["VIEWPOINT 0 0 0 1 0 0 0", f"POINTS {len(points)}", "DATA binary", ""]
    with open(name, "wb") as file:
        file.write("\n".join(lines).encode() + points.tobytes())


sweep = rng.uniform(-50, 50, (34_688, 5)).astype(np.float32)
sweep.tofile("sweep.pcd.bin")
read = PointCloud.read("sweep.pcd.bin")
right = np.isin(read.position[:, 0], sweep[:, 0]) & np.isin(read.position[:, 2], sweep[:, 2])
print(f"nuScenes: {len(sweep)} points, read {len(read)}, right {right.mean():.0%}")
assert len(read) == 43_360 and np.isclose(right.mean(), 0.2, atol=0.001)

kitti = np.c_[rng.uniform(-50, 50, (1000, 3)), rng.uniform(0, 0.99, 1000)].astype(np.float32)
kitti.tofile("kitti.bin")
convert("kitti.bin", "kitti.las")
las = PointCloud.read("kitti.las")
off_m = np.abs(las.position - kitti[:, :3])
print(f"LAS: up to {off_m.max() * 1000:.1f} mm off, intensities {set(las.intensity)}")
assert 0.004 < off_m.max() < 0.0051 and not las.intensity.any()

reds = np.arange(256, dtype=np.uint32)
coloured = np.zeros(256, [("x", "f4"), ("y", "f4"), ("z", "f4"), ("rgb", "f4")])
coloured["x"], coloured["rgb"] = reds, (0xFF000000 | reds << 16 | 0x6432).astype(np.uint32).view(np.float32)
save_pcd("coloured.pcd", coloured)
rgb = PointCloud.read("coloured.pcd").rgb
print("red of 127 and 128:", rgb[127].tolist(), rgb[128].tolist())
assert np.array_equal(rgb[:128], np.c_[reds[:128], np.full(128, 0x64), np.full(128, 0x32)]) and not rgb[128:].any()

doubles = np.zeros(100, [("x", "f8"), ("y", "f8"), ("z", "f8"), ("intensity", "f4")])
doubles["x"], doubles["y"], doubles["z"], doubles["intensity"] = 691_000.123 + np.arange(100), 5_330_000.456, np.arange(100) * 0.1, np.arange(100)
save_pcd("map.pcd", doubles)
points, others = pypointcloud.load_pcd("map.pcd")
print("float64:", [doubles[name][1].item() for name in "xyz"], "read by pypointcloud:", points[1].tolist())
assert points.shape == (100, 3) and points.dtype == np.float32
assert np.abs(points).max() < 1000 and np.array_equal(others["intensity"], doubles["intensity"])
PYTHON
