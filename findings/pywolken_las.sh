#!/usr/bin/env bash
# A mobile lidar's points, 20 000 on 60 m of road, with their rings (an extra dimension) and GPS times (1e9 s less, as LAS has them), go through pipelines of pywolken (a PDAL in Python)
# and into a LAS file again: with heights above ground (`filters.hag`), as longitudes and latitudes (`filters.reprojection`, as its documentation has it), and from a PLY file with
# intensities from 0 to 1, as most drivers of ROS send them. Guess: heights and rings are extra dimensions of the file, degrees have a finer scale than metres, intensities are scaled.
# Seen with pywolken 0.1.1 and laspy 2.7.0 on 2026-11-30, without a word; each `execute` tells of 20 000 points:
# - heights and rings are gone: what laspy does not know by name is passed over. The times are there, but the file's header now calls them seconds of a week
# - all 20 000 points are at 4 places, 111 m apart: a LAS file gets steps of 0.001 of whatever its unit is
# - all intensities below 1 are 0
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3.11 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check pywolken==0.1.1 laspy==2.7.0 lazrs==0.8.2 numpy==2.4.6 scipy==1.17.1 pyproj==3.7.2 2>/dev/null
cat >survey.py <<'PYTHON'
import json

import laspy
import numpy as np
import pywolken

COUNT = 20_000
rng = np.random.default_rng(0)
is_sign = np.arange(COUNT) % 10 == 0
header = laspy.LasHeader(point_format=1, version="1.2")
header.offsets, header.scales = [691_600, 5_337_000, 500], [0.001] * 3
header.global_encoding.gps_time_type = laspy.header.GpsTimeType.STANDARD
header.add_extra_dim(laspy.ExtraBytesParams("ring", "uint8"))
survey = laspy.LasData(header)
survey.x, survey.y, survey.z = 691_630 + rng.uniform(0, 60, COUNT), 5_337_000 + rng.uniform(0, 60, COUNT), np.where(is_sign, 502.5, 500.0)
survey.classification = np.where(is_sign, 1, 2).astype(np.uint8)
survey.gps_time = 400_000_000 + np.arange(COUNT) * 1e-4
survey.ring = (np.arange(COUNT) % 32).astype(np.uint8)
survey.write("survey.las")


def processed(source, *filters):
    assert pywolken.Pipeline(json.dumps({"pipeline": [source, *filters, "processed.las"]})).execute() == COUNT
    return laspy.read("processed.las")


cloud = pywolken.Pipeline(json.dumps({"pipeline": ["survey.las", {"type": "filters.hag"}]}))
cloud.execute()
cloud = cloud.result
print("in the pipeline: height above ground up to", cloud["HeightAboveGround"].max(), "m, rings up to", cloud["ring"].max())
assert cloud["HeightAboveGround"].max() == 2.5 and cloud["ring"].max() == 31
heights = processed("survey.las", {"type": "filters.hag"})
print("extra dimensions in the file:", list(heights.point_format.extra_dimension_names), "times from", heights.gps_time[0], heights.header.global_encoding.gps_time_type.name)
assert not list(heights.point_format.extra_dimension_names) and heights.gps_time[0] == 400_000_000
assert heights.header.global_encoding.gps_time_type == laspy.header.GpsTimeType.WEEK_TIME

places = processed("survey.las", {"type": "filters.reprojection", "in_srs": "EPSG:25832", "out_srs": "EPSG:4326"})
degrees = np.unique(np.column_stack([places.x, places.y]), axis=0)
print("places in degrees:", degrees.round(6).tolist(), "steps", places.header.scales.tolist())
assert len(places) == COUNT and len(degrees) == 4 and (places.header.scales == 0.001).all()

intensity = rng.uniform(0, 1, COUNT).astype(np.float32)
pywolken.write(pywolken.PointCloud.from_dict({"X": np.array(survey.x), "Y": np.array(survey.y), "Z": np.array(survey.z), "Intensity": intensity}), "survey.ply")
assert np.array_equal(pywolken.read("survey.ply")["Intensity"], intensity)
print("intensities of the PLY file:", intensity.min(), "to", intensity.max(), "and of the LAS file:", np.unique(processed("survey.ply").intensity))
assert np.unique(processed("survey.ply").intensity).tolist() == [0]
PYTHON
venv/bin/python survey.py >said.txt 2>&1 || { cat said.txt; exit 1; }
cat said.txt
if grep -iE "warn|drop|lost" said.txt; then exit 1; fi
