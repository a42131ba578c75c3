#!/usr/bin/env bash
# A map in UTM coordinates is written with Open3D, whose points are float64, as PLY, PCD and XYZ, in binary and as text, and read again.
# Guess: nothing changes, or text is rounded somewhere beyond the millimetre. Seen with open3d-cpu 0.20.0 on 2026-11-29, for a northing of
# 5,330,004.654321 m, by one function, `write_point_cloud`, that returns True each time:
#   .ply    binary exact; as text 5.33e+06, six digits: 4.65 m off, and three points a metre apart are one
#   .pcd    binary 5330004.5 (single precision); as text within a millimetre
#   .xyz    within a millimetre
# So the one format is good where the other is not. Colours become 8 bits in PLY and PCD.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check open3d-cpu==0.20.0 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import numpy as np
import open3d

NORTH_M = 5_330_004.654321
EXPECTED = {
    ("ply", False): NORTH_M, ("ply", True): 5_330_000.0, ("pcd", False): 5_330_004.5, ("pcd", True): NORTH_M,
    ("xyz", False): NORTH_M,
}
points = np.array([[690_004.123456, NORTH_M + offset_m, 500.123456] for offset_m in (0.0, -1.0, -2.0)])
cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
for (suffix, text), north in EXPECTED.items():
    assert open3d.io.write_point_cloud(f"map.{suffix}", cloud, write_ascii=text)
    read = np.asarray(open3d.io.read_point_cloud(f"map.{suffix}").points)
    print(f".{suffix}, {'text' if text else 'binary'}: northing {read[0, 1]}, {len(np.unique(read, axis=0))} different points of 3")
    assert abs(read[0, 1] - north) < 1e-3
    assert len(np.unique(read[:, 1])) == (1 if (suffix, text) == ("ply", True) else 3)
PYTHON
