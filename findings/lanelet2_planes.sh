#!/usr/bin/env bash
# A map of lanes (Lanelet2, .osm) goes with a drive, whose positions are metres east, north and up of an origin in Munich, on the plane that touches the
# Earth there, as simulators and localisation have them. The map is loaded with that origin by `UtmProjector`, as in the examples of Lanelet2.
# Where is a point of the map that the drive has 1 km north, and one 5 km east? Guess: there, to the centimetre, as the origin is near.
# Seen with lanelet2 1.2.3 and pymap3d 3.2.0 on 2026-11-29, without a word:
# - 1 km north is 33 m too far west, and 5 km east is 167 m too far north: its axes are those of the UTM zone, whose north is 1.9 degrees off in Munich,
#   and by the origin they are only shifted
# - what is 5 km east is 2 m higher than on the plane, as UTM keeps heights above the ellipsoid
# `LocalCartesianProjector` has the plane of the drive, to the last digit. A file has latitudes and longitudes, and nothing tells by which
# projector its lanes were drawn: drawn on one and written by the other, the map is turned for good.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check lanelet2==1.2.3 pymap3d==3.2.0 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PYTHON'
import lanelet2
import numpy as np
import pymap3d

LAT, LON = 48.1372, 11.5761
DRIVE_M = {"origin": (0.0, 0.0, 0.0), "north": (0.0, 1000.0, 0.0), "east": (5000.0, 0.0, 0.0)}

origin = lanelet2.io.Origin(LAT, LON, 0.0)
projectors = {
    "UtmProjector": lanelet2.projection.UtmProjector(origin),
    "LocalCartesianProjector": lanelet2.projection.LocalCartesianProjector(origin),
}
right = projectors["LocalCartesianProjector"]
points = {}
for place, (east, north, up) in DRIVE_M.items():
    lat, lon, height = pymap3d.enu2geodetic(east, north, up, LAT, LON, 0)
    points[place] = lanelet2.core.Point3d(lanelet2.core.getId(), right.forward(lanelet2.core.GPSPoint(lat, lon, height)))
line = lanelet2.core.LineString3d(lanelet2.core.getId(), list(points.values()))
drawn = lanelet2.core.LaneletMap()
drawn.add(line)
lanelet2.io.write("map.osm", drawn, right)

off = {}
for name, projector in projectors.items():
    loaded = lanelet2.io.load("map.osm", projector)
    for place, wanted in DRIVE_M.items():
        point = loaded.pointLayer[points[place].id]
        off[name, place] = np.array([point.x, point.y, point.z]) - wanted
        print(f"{name}, {place}: {off[name, place].round(2).tolist()} m off")
for place in DRIVE_M:
    assert np.allclose(off["LocalCartesianProjector", place], 0, atol=1e-3)
assert np.allclose(off["UtmProjector", "origin"], 0, atol=1e-3)
assert np.allclose(off["UtmProjector", "north"], [-33.5, -0.5, 0.1], atol=0.1)
assert np.allclose(off["UtmProjector", "east"], [-2.5, 167.5, 2.0], atol=0.1)
PYTHON
