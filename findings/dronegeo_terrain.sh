#!/usr/bin/env bash
# A drone surveys a plain for a field robot's map; dronegeo makes of its points and elevations (GeoTIFF, north up) what maps need:
# - a hill, lit from the north-west (`generate_hillshade`, azimuth 315, its default). Guess: its north-western side is bright, the other dark
# - 60 m x 60 m of field at 500 m with a hall, 10 m high, on its eastern third; points are classified, and the file has those of the ground first, then those of the roof, as merged from two
#   files. Terrain of class 2 (`create_dtm`). Guess: 500 m all over, with chunks of any size, in the system of the file (UTM 33)
# - a slope of 20 %, surveyed twice, nothing changed; the second grid, of the same shape, starts 2 m further east, as each begins where its flight does. Guess for `compute_cut_fill_volume`:
#   an error, or no change. Seen with dronegeo 0.1.3 on 2026-12-01, without a word:
# - the south-eastern side is bright (from north-east it is right): the azimuth is turned from clockwise of north to anticlockwise of east, the slope's is not. The hill looks like a pit
# - if the file is larger than a chunk, so that one chunk has no ground, all of that chunk is ground: the hall's terrain is 510 m. And it is said to be in UTM 32, the default, 6 degrees west
# - 0.4 m are filled everywhere, 4000 m³ per hectare: shapes are compared, places are not
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3.11 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check dronegeo==0.1.3 numpy==2.4.6 scipy==1.17.1 laspy==2.7.0 lazrs==0.8.2 rasterio==1.4.3 shapely==2.2.0 pyproj==3.7.2 matplotlib==3.11.2 2>/dev/null
cat >terrain.py <<'PYTHON'
import dronegeo as dg
import laspy
import numpy as np
import rasterio
from pyproj import CRS
from rasterio.transform import from_origin

SIZE = 100


def write(path, heights_m, east_m=691_000.0):
    place = {"transform": from_origin(east_m, 5_337_000.0, 1.0, 1.0), "nodata": -10000.0}
    with rasterio.open(path, "w", driver="GTiff", height=SIZE, width=SIZE, count=1, dtype="float32", **place) as file:
        file.write(heights_m.astype(np.float32), 1)


def read(path):
    with rasterio.open(path) as file:
        return file.read(1), file.transform, file.crs


east_m, south_m = np.meshgrid(np.arange(SIZE) + 0.5, np.arange(SIZE) + 0.5)
write("hill.tif", 500 + 20 * np.exp(-((east_m - 50) ** 2 + (south_m - 50) ** 2) / 400))
for azimuth, seen in ((315, ("dark", "bright")), (45, ("bright", "dark"))):
    dg.analysis.generate_hillshade("hill.tif", "shade.tif", azimuth_deg=azimuth)
    shade, *_ = read("shade.tif")
    to_light = -10 if azimuth == 315 else 10  # columns from the top to the side that faces the light
    sides = int(shade[40, 50 + to_light]), int(shade[60, 50 - to_light])
    print(f"light from {azimuth} degrees: the side that faces it {sides[0]}, the other {sides[1]}, flat land {shade[0, 0]}")
    assert tuple("bright" if side > shade[0, 0] else "dark" for side in sides) == seen

rng = np.random.default_rng(0)
COUNT = 120_000
is_roof = np.arange(2 * COUNT) >= COUNT
header = laspy.LasHeader(point_format=1, version="1.2")
header.add_crs(CRS.from_epsg(25833))
header.offsets, header.scales = [691_000, 5_337_000, 500], [0.001] * 3
survey = laspy.LasData(header)
survey.x = 691_000 + np.where(is_roof, rng.uniform(40, 60, 2 * COUNT), rng.uniform(0, 40, 2 * COUNT))
survey.y = 5_337_000 + rng.uniform(0, 60, 2 * COUNT)
survey.z = np.where(is_roof, 510.0, 500.0)
survey.classification = np.where(is_roof, 6, 2).astype(np.uint8)
survey.write("survey.las")
for chunk_size, seen_m in ((2_500_000, 500), (100_000, 510)):
    dg.dem.create_dtm("survey.las", "dtm.tif", resolution=0.5, config=dg.config.ComputeConfig(n_jobs=1, chunk_size=chunk_size))
    heights_m, transform, crs = read("dtm.tif")
    column, row = (int(index) for index in ~transform * (691_050, 5_337_030))
    print(f"chunks of {chunk_size} points, {2 * COUNT} in the file: terrain below the hall's middle {heights_m[row, column]:.1f} m, in EPSG:{crs.to_epsg()}")
    assert abs(heights_m[row, column] - seen_m) < 0.1 and crs.to_epsg() == 32632

write("before.tif", 500 + 0.2 * east_m)
write("after.tif", 500 + 0.2 * (east_m + 2), 691_002.0)
report = dg.analysis.compute_cut_fill_volume("before.tif", "after.tif")
print(f"nothing changed: cut {report.cut_volume_m3:.0f} m³, fill {report.fill_volume_m3:.0f} m³ on {report.surface_area_m2:.0f} m²")
assert (round(report.cut_volume_m3), round(report.fill_volume_m3)) == (0, 4000)
PYTHON
venv/bin/python terrain.py >said.txt 2>&1 || { cat said.txt; exit 1; }
cat said.txt
if grep -iE "warn|error" said.txt; then exit 1; fi
