#!/usr/bin/env bash
# A cloud with ring (uint16) and time (float64) of each point is saved as PLY with pyntcloud. Who can read it?
# Guess: everyone, since PLY has `ushort` and `double`. Seen with pyntcloud 0.3.1, pandas 2.3.3 and plyfile 1.1.5 on 2026-11-28: nobody. The
# header goes by the first letter of a type: all floats are `float`, all unsigned integers `uchar`, all signed ones `int`, while the bytes
# that follow are those of the array. From the first wider field on all is shifted: of the points (1, 4, 7), (2, 5, 8), (3, 6, 9) the second
# is read as (8.5e-44, -1.08e-19, 9.0e-44), by pyntcloud itself, too, without a word.
# x, y and z alone are well: those it makes float32 itself.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check pyntcloud==0.3.1 pandas==2.3.3 plyfile==1.1.5 numpy==2.4.6
cd "$folder"
venv/bin/python -W ignore - <<'PYTHON'
import numpy as np
import pandas as pd
from plyfile import PlyData
from pyntcloud import PyntCloud

XYZ = np.array([[1, 4, 7], [2, 5, 8], [3, 6, 9]], dtype=np.float32)


def saved(**fields):
    """Return x, y, z of a cloud that was saved, as both readers have them, and the types in its header."""
    points = {name: XYZ[:, column] for column, name in enumerate("xyz")} | fields
    PyntCloud(pd.DataFrame(points)).to_file("cloud.ply")
    vertices = PlyData.read("cloud.ply")["vertex"]
    types = [f"{part.val_dtype} {part.name}" for part in vertices.properties]
    own = PyntCloud.from_file("cloud.ply").points[["x", "y", "z"]].to_numpy()
    return np.column_stack([vertices[name] for name in "xyz"]), own, types


for fields in (
    {"intensity": np.float32([0, 1, 2])},
    {"ring": np.uint16([5, 300, 7]), "t": np.array([0.1, 0.2, 0.3])},
    {name: XYZ[:, column].astype(np.float64) for column, name in enumerate("xyz")},
):
    plyfile, own, types = saved(**fields)
    print(f"{types}\n  second point: {plyfile[1]} by plyfile, {own[1]} by pyntcloud")
    right = "t" not in fields
    assert np.array_equal(plyfile, XYZ) == right
    assert np.array_equal(own, XYZ) == right
PYTHON
