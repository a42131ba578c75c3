#!/usr/bin/env bash
# A board of 0.4 x 0.3 x 0.02 m, a mesh whose origin is at one of its corners, lies in a MuJoCo simulation at (1, 2, 3), not turned. Poses of objects for a
# dataset are taken from there: `geom_xpos` and `geom_xmat` of the mesh. Where do they put the vertices of the file?
# Guess: where MuJoCo has the board. Seen with mujoco 4.0.0 on 2026-11-29, without a word:
# - the pose is (1.2, 2.15, 3.01), turned by half a turn: it is that of the board's centre of mass and principal axes, to which MuJoCo moves the
#   vertices when it loads a mesh. The vertices of the file stand upright then, 0.4 m along z
# - `mesh_vert` has the moved ones, in single precision, and with that pose they are right; `mesh_pos` and `mesh_quat` say how they were moved, so
#   the pose of the file's frame is geom * inverse(mesh). The pose of the BODY is not touched: (1, 2, 3)
# Which way the axes turn depends on the shape alone, so each object of a dataset is turned in its own way, and a mesh that is built about its
# centre with its longest side along z is not turned at all.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check mujoco==4.0.0 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
from itertools import product
from pathlib import Path

import mujoco
import numpy as np

FACES = [(1, 2, 4), (1, 4, 3), (5, 7, 8), (5, 8, 6), (1, 5, 6), (1, 6, 2), (3, 4, 8), (3, 8, 7), (1, 3, 7), (1, 7, 5), (2, 6, 8), (2, 8, 4)]
WORLD = """<mujoco><asset><mesh name="board" file="board.obj"/></asset>
  <worldbody><body name="board" pos="1 2 3"><freejoint/><geom type="mesh" mesh="board"/></body></worldbody></mujoco>"""

vertices = np.array(list(product((0, 0.4), (0, 0.3), (0, 0.02))))
Path("board.obj").write_text("".join(f"v {x} {y} {z}\n" for x, y, z in vertices) + "".join(f"f {a} {b} {c}\n" for a, b, c in FACES))
Path("world.xml").write_text(WORLD)
model = mujoco.MjModel.from_xml_path("world.xml")
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)


def placed(points, translation, rotation):
    return points @ np.reshape(rotation, (3, 3)).T + translation


def extent(points):
    return np.ptp(points, axis=0)


def corners(points):
    return np.array(sorted(np.round(points, 4).tolist()))


turn = np.empty(9)
mujoco.mju_quat2Mat(turn, model.mesh_quat[0])
mesh_points = placed(vertices - model.mesh_pos[0], [0, 0, 0], turn.reshape(3, 3).T)  # the inverse of `mesh_pos` and `mesh_quat`
by_file = placed(vertices, data.geom_xpos[0], data.geom_xmat[0])
by_mesh = placed(model.mesh_vert, data.geom_xpos[0], data.geom_xmat[0])
print(f"body {data.xpos[1].tolist()}, geom {data.geom_xpos[0].round(4).tolist()}, axes {data.geom_xmat[0].round(2).tolist()}")
print(f"extent of the file's vertices there {extent(by_file).round(3).tolist()}, of mesh_vert {extent(by_mesh).round(3).tolist()}")
assert np.allclose(data.xpos[1], [1, 2, 3]) and np.allclose(data.geom_xpos[0], [1.2, 2.15, 3.01])
assert np.allclose(extent(by_file), [0.02, 0.3, 0.4]) and np.allclose(extent(by_mesh), [0.4, 0.3, 0.02], atol=1e-6)
assert np.allclose(corners(by_mesh), corners(vertices + [1, 2, 3]), atol=1e-3)
assert np.allclose(placed(mesh_points, data.geom_xpos[0], data.geom_xmat[0]), vertices + [1, 2, 3], atol=1e-6)
PYTHON
