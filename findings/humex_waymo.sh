#!/usr/bin/env bash
# A file of Waymo's motion dataset (scenarios, of 91 states, ten a second) has two scenarios. In the first a car follows a lane, 30 m above the sea; a
# pedestrian and a lorry of 12 m are near. The left boundary of the lane is two painted lines, one after the other, as Waymo's maps have them. It is converted
# with humex, which measures how vehicles behave. Guess: two scenarios; sizes and heights as they are; a boundary along all of the lane; 10 Hz. Seen with
# humex 0.2.3 and humex-converter-waymo 0.2.0 on 2026-11-30, without a word:
# - one scenario: the first. Waymo's files have hundreds
# - the pedestrian, the lorry and the car are each 4.5 x 2 x 1.8 m
# - what moves is at height 0, and boundaries are; the middle of the lane is at 30 m
# - of two lines that are the left boundary the last is there alone, so that the first half of the lane has none, in an array that begins 50 m later than the
#   right one and the middle
# - 10.11 Hz: 91 states in 9.0 s
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check humex==0.2.3 protobuf==4.25.8 numpy==2.4.6
venv/bin/pip install --quiet --disable-pip-version-check --no-deps humex-converter-waymo==0.2.0 waymo-open-dataset-tf-2-12-0==1.6.7  # its messages, without TensorFlow
cat > write.py <<'PYTHON'
import struct

from waymo_open_dataset.protos import scenario_pb2

HEIGHT_M = 30.0


def line(polyline, begin_m, end_m, y_m):
    for x_m in range(begin_m, end_m):
        polyline.add(x=x_m, y=y_m, z=HEIGHT_M)


def scenario(name):
    made = scenario_pb2.Scenario(scenario_id=name, timestamps_seconds=[tick / 10 for tick in range(91)], sdc_track_index=0)
    kinds = scenario_pb2.Track
    for number, kind, size, begin_m, speed in (
        (1, kinds.TYPE_VEHICLE, (5.2, 2.1, 1.9), 0, 10),
        (2, kinds.TYPE_PEDESTRIAN, (0.8, 0.8, 1.8), 50, 0),
        (3, kinds.TYPE_VEHICLE, (12.0, 2.55, 3.5), -30, 8),
    ):
        track = made.tracks.add(id=number, object_type=kind)
        length, width, height = size
        for tick in range(91):
            state = track.states.add(valid=True, center_x=begin_m + speed * tick / 10, center_z=HEIGHT_M + height / 2, velocity_x=speed)
            state.length, state.width, state.height = length, width, height
    lane = made.map_features.add(id=1).lane
    line(lane.polyline, 0, 100, 0)
    for number, begin_m, end_m, boundaries, y_m in ((10, 0, 50, lane.left_boundaries, 2), (11, 50, 100, lane.left_boundaries, 2), (12, 0, 100, lane.right_boundaries, -2)):
        line(made.map_features.add(id=number).road_line.polyline, begin_m, end_m, y_m)
        boundaries.add(boundary_feature_id=number, lane_start_index=begin_m, lane_end_index=end_m - 1)
    return made.SerializeToString()


with open("drive.tfrecord", "wb") as file:
    for record in (scenario("first"), scenario("second")):
        file.write(struct.pack("<Q", len(record)) + bytes(4) + record + bytes(4))
PYTHON
venv/bin/python write.py
venv/bin/humex convert drive.tfrecord --output converted > said.txt 2>&1 || { cat said.txt; exit 1; }
if grep -iE 'second|skip|size|boundar|height' said.txt; then exit 1; fi
find converted -name '*.pb' | sort > files.txt
cat > read.py <<'PYTHON'
from pathlib import Path

from humex.proto import map_pb2, scenario_pb2

files = {Path(line).stem.split("_")[0]: Path(line) for line in Path("files.txt").read_text().split()}
scenarios = [line for line in Path("files.txt").read_text().split() if Path(line).stem.startswith("scenario")]
scenario, drawn = scenario_pb2.ScenarioData(), map_pb2.Map()
scenario.ParseFromString(files["scenario"].read_bytes())
drawn.ParseFromString(files["map"].read_bytes())
sizes = {number: (round(thing.length, 2), round(thing.width, 2), round(thing.height, 2)) for number, thing in sorted(scenario.roster.items())}
heights = {thing.sp.position.z for frame in scenario.frames.values() for thing in frame.obj_list.values()}
lane = drawn.map_data.lanes[1]
ends = {name: (segments[0].points[0], segments[0].points[-1]) for name, segments in (("middle", lane.center_line), ("left", lane.left_boundary), ("right", lane.right_boundary))}
spans = {name: (first.x, last.x, last.z) for name, (first, last) in ends.items()}
print(f"{len(scenarios)} scenario, {sizes}, at {heights} m, {scenario.frequency:.2f} Hz; from x to x, at z: {spans}")
assert len(scenarios) == 1
assert sizes == dict.fromkeys((1, 2, 3), (4.5, 2.0, 1.8))
assert heights == {0.0}
assert spans == {"middle": (0, 99, 30), "left": (50, 99, 0), "right": (0, 99, 0)}
assert round(scenario.frequency, 2) == 10.11
PYTHON
venv/bin/python read.py
