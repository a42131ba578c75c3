#!/usr/bin/env bash
# A lidar's cloud goes through Draco, as with point_cloud_transport: a quarter of its beams hit nothing and are zeros, as drivers send them, and one return is a stray one
# from 100 km away. What does DracoPy give back?
# Guess: as many points, moved by some millimetres, maybe in another order, which its help says. Seen with DracoPy 2.2.0 on 2026-11-29, without a word:
# - by default, points that are equal become one: of 2,000 there are 1,501, so a cloud of rows and columns has lost its shape. With the ring as an attribute, as many
#   zeros are kept as there are rings of them; with a number that differs for each point, all of them are. Only `preserve_order` keeps equal points, which its help
#   does not say
# - the stray return takes the precision of all others: 14 bits are those of the whole cloud, so they are up to 3 m wrong instead of 5 mm
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check DracoPy==2.2.0 numpy==2.3.4
"$folder/venv/bin/python" - <<'PYTHON'
import DracoPy
import numpy as np

points_m = np.random.default_rng(1).uniform(-80, 80, (2000, 3)).astype(np.float32)
points_m[::4] = 0
ring = np.arange(2000, dtype=np.uint16).reshape(-1, 1) % 64
number = np.arange(2000, dtype=np.uint32).reshape(-1, 1)


def through_draco(points, **options):
    return DracoPy.decode(DracoPy.encode(points, **options))


left = {
    "alone": len(through_draco(points_m).points),
    "with their rings": len(through_draco(points_m, generic_attributes={"ring": ring}).points),
    "with their numbers": len(through_draco(points_m, generic_attributes={"number": number}).points),
    "in their order": len(through_draco(points_m, preserve_order=True).points),
}
print("points of 2,000:", left)
assert left == {"alone": 1501, "with their rings": 1516, "with their numbers": 2000, "in their order": 2000}

worst_m = {}
for name, far_m in {"near": 80.0, "stray": 1e5}.items():
    points_m[1] = far_m, 0, 0
    moved_m = np.abs(through_draco(points_m, preserve_order=True).points - points_m)
    worst_m[name] = float(np.delete(moved_m, 1, axis=0).max())
print("moved by up to (m):", {name: round(moved, 4) for name, moved in worst_m.items()})
assert worst_m["near"] < 0.006 and 2.5 < worst_m["stray"] < 3.2
PYTHON
