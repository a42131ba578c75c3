#!/usr/bin/env bash
# A part of a robot, 0.1 x 0.2 x 0.3 m, is a COLLADA file as CAD programs export it: 100 x 200 x 300, `<unit meter="0.001"/>`; its up axis is z, or y. It is the
# mesh of a link in a URDF. How large is it? Guess: 0.1 x 0.2 x 0.3 m, since the file says so, in one orientation or the other.
# Seen on 2026-11-29, without a word:
#   yourdfpy 0.0.60, urchin 0.0.30 (by trimesh 5.2.0 and pycollada 0.9.3), pin 4.1.0   100 x 200 x 300 m, whatever unit or up axis
#   assimp 5.2.5 of Debian 12, by which RViz loads meshes of COLLADA                   0.1 x 0.3 x 0.2 m if z is up, 0.1 x 0.2 x 0.3 if y is
# So a part that has its size in RViz fills the whole scene elsewhere, as an obstacle or in rendered masks, and `scale` in the URDF, which mends the one,
# breaks the other. assimp's scenes have y up, so there z and y change places. trimesh knows the unit as a text (`units`: "0.001 * meters"); the COLLADA that
# it writes names none, and y as the way up, with the same numbers.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check yourdfpy==0.0.60 urchin==0.0.30 trimesh==5.2.0 pycollada==0.9.3 pin==4.1.0
cd "$folder"
apt-get download --quiet=2 -o APT::Sandbox::User=root assimp-utils=5.2.5~ds0-1+b1 libassimp5=5.2.5~ds0-1+b1 libdraco7 libminizip1 libpugixml1v5
for package in *.deb; do dpkg --extract "$package" debian; done
for up in Z_UP Y_UP; do
  cat >$up.dae <<XML
<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><created>2026-01-01T00:00:00</created><modified>2026-01-01T00:00:00</modified>
  <unit name="millimeter" meter="0.001"/><up_axis>$up</up_axis></asset>
<library_geometries><geometry id="part"><mesh>
  <source id="points"><float_array id="numbers" count="12">0 0 0 100 0 0 0 200 0 0 0 300</float_array><technique_common>
    <accessor source="#numbers" count="4" stride="3"><param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/></accessor>
  </technique_common></source>
  <vertices id="vertices"><input semantic="POSITION" source="#points"/></vertices>
  <triangles count="4"><input semantic="VERTEX" source="#vertices" offset="0"/><p>0 2 1 0 1 3 0 3 2 1 2 3</p></triangles>
</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="scene"><node id="node"><instance_geometry url="#part"/></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#scene"/></scene></COLLADA>
XML
  echo "<robot name='r'><link name='base'><visual><geometry><mesh filename='$up.dae'/></geometry></visual></link></robot>" >$up.urdf
  LD_LIBRARY_PATH=debian/usr/lib/x86_64-linux-gnu debian/usr/bin/assimp export $up.dae $up.obj -ptv >log
done
venv/bin/python -W ignore - <<'PYTHON'
from pathlib import Path

import numpy as np
import pinocchio
import trimesh
import urchin
import yourdfpy

for up, by_assimp in {"Z_UP": [0.1, 0.3, 0.2], "Y_UP": [0.1, 0.2, 0.3]}.items():
    urdf = f"{up}.urdf"
    box = pinocchio.buildGeomFromUrdf(pinocchio.buildModelFromUrdf(urdf), urdf, pinocchio.GeometryType.VISUAL, ["."]).geometryObjects[0].geometry
    box.computeLocalAABB()
    (mesh,) = urchin.URDF.load(urdf).links[0].visuals[0].geometry.meshes
    seen = {
        "yourdfpy": yourdfpy.URDF.load(urdf).scene.extents,
        "urchin": mesh.extents,
        "pin": box.aabb_local.max_ - box.aabb_local.min_,
        "assimp": np.ptp([[float(part) for part in line.split()[1:]] for line in Path(f"{up}.obj").read_text().splitlines() if line[:2] == "v "], axis=0),
    }
    for name, extents in seen.items():
        print(f"{up}, {name}: {np.round(extents, 4).tolist()}")
        assert np.allclose(extents, by_assimp if name == "assimp" else [100, 200, 300])
    assert trimesh.load(f"{up}.dae").units == "0.001 * meters"
trimesh.load("Z_UP.dae", force="mesh").export("again.dae")
again = Path("again.dae").read_text()
assert "<up_axis>Y_UP" in again and "<unit" not in again
PYTHON
