#!/usr/bin/env bash
# A recorded scene becomes a CommonRoad scenario, with the place on Earth that its local coordinates count from: `CommonRoadFileWriter(…, location=…)`. It is
# written, and read again. Where is it? Guess: at that place, in both formats; numbers are rounded to four decimals, as `decimal_precision=4` says.
# Seen with commonroad-io 2026.1 on 2026-11-29, without a word:
# - nowhere: latitude and longitude are 999, which stands for "unknown", as the writer takes `lanelet_network.location` and never looks at its
#   own argument. Given there, the place is written with all its digits
# - decimals are cut, not rounded: a car at -0.00019 m and 9.99999 m/s is at -0.0001 m and has 9.9999 m/s; so all of a map moves towards zero
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check commonroad-io==2026.1 numpy==2.4.6
cd "$folder"
venv/bin/python -W ignore - <<'PYTHON'
import numpy as np
from commonroad.common.common_scenario import Location
from commonroad.common.file_reader import CommonRoadFileReader
from commonroad.common.file_writer import CommonRoadFileWriter, OverwriteExistingFile
from commonroad.common.util import FileFormat
from commonroad.geometry.obstacle_shapes.rect_obstacle_shape import RectObstacleShape
from commonroad.planning.planning_problem import PlanningProblemSet
from commonroad.scenario.obstacle import ObstacleType, StaticObstacle
from commonroad.scenario.scenario import Scenario, ScenarioID, Tag
from commonroad.scenario.state import InitialState

PLACE = Location(gps_latitude=48.1372345678, gps_longitude=11.5761234567)
POSITION_M, SPEED_MPS = np.array([-0.00019, 12.00019]), 9.99999

state = InitialState(position=POSITION_M, orientation=0.0, velocity=SPEED_MPS, time_step=0, acceleration=0.0, yaw_rate=0.0, slip_angle=0.0)
scenario = Scenario(0.1, ScenarioID.from_benchmark_id("DEU_Test-1_1_T-1", "2020a"))
scenario.add_objects(StaticObstacle(5, ObstacleType.CAR, RectObstacleShape(1.8, 4.5), state))


def written(name):
    """Write the scenario with the place, and return what is read."""
    writer = CommonRoadFileWriter(scenario, PlanningProblemSet(), "", "", "", {Tag.URBAN}, location=PLACE, file_format=FileFormat.XML)
    writer.write_to_file(name, OverwriteExistingFile.ALWAYS)
    return CommonRoadFileReader(name).open()[0]


def place(read):
    return read.lanelet_network.location.gps_latitude, read.lanelet_network.location.gps_longitude


by_argument = written("argument.xml")
scenario.lanelet_network.location = PLACE
by_network = written("network.xml")
car = by_argument.obstacle_by_id(5).initial_state
print(f"place given to the writer: {place(by_argument)}, to the network: {place(by_network)}")
print(f"car at {car.position.tolist()} with {car.velocity} m/s")
assert place(by_argument) == (999, 999)
assert place(by_network) == (PLACE.gps_latitude, PLACE.gps_longitude)
assert car.position.tolist() == [-0.0001, 12.0001]
PYTHON
