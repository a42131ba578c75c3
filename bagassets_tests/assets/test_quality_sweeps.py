"""Clouds against the poses: stamps that are off by a known time are found, and what the check says fixes them."""

import heapq
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pytest
from numpy.lib.recfunctions import repack_fields
from sample_drives import build_recordings

from bagassets.assets.quality.evidence import Evidence
from bagassets.assets.quality.sweep_rules import Sweeps, sweeps_timed
from bagassets.geometry.se3 import quaternion_multiply
from bagassets.geometry.trajectory import Trajectory
from bagassets.recipe import load_recipe
from bagassets.recipe.model import Rig
from bagassets.recipe.model_checks import SweepTimesCheck
from bagassets.sample.messages import Messages
from bagassets.sample.recorder import open_recorder
from bagassets.sample.render import lidar_points
from bagassets.sample.rig import EGO_SE3_LIDAR
from bagassets.sample.schedule import Event, motion_events
from bagassets.sample.truth import Truth
from bagassets.sample.world import RADIUS_M, Ego, Thing, World
from bagassets.store.store import Store
from bagassets_tests.checks import RECORDING_CHECKS

pytestmark = pytest.mark.once

PERIOD_NS, MS = 100_000_000, 1_000_000
START_NS = 1_750_000_000_000_000_000
CLOUDS = 42


@dataclass(frozen=True)
class Lively(Ego):
    """A car that brakes, drives off and steers to and fro."""

    def pose(self, times_s):
        positions, rotations = super().pose(times_s + 0.25 * np.sin(1.2 * times_s))
        half = 0.04 * np.sin(times_s)
        steered = np.zeros_like(rotations)
        steered[..., 0], steered[..., 3] = np.cos(half), np.sin(half)
        return positions, quaternion_multiply(rotations, steered)


def scenery(seed):
    """Houses, walls and posts beside the road, at angles to it."""
    dice = np.random.default_rng(seed)
    things = []
    for number in range(40):
        lateral_m = dice.choice([-1, 1]) * dice.uniform(7, 24)
        along_m = dice.uniform(-30, 70)
        size = (dice.uniform(0.3, 5), dice.uniform(0.3, 5), dice.uniform(2, 6))
        yaw = dice.uniform(0, np.pi)
        things.append(
            Thing(number + 1, "", size, RADIUS_M - lateral_m, along_m / RADIUS_M, 0.0, yaw, (90, 90, 90))
        )
    return tuple(things)


class Drive:
    """What the lidar of a car sees, and where the car is; no cameras."""

    def __init__(self, seed, ego=Lively):
        world = World(0)
        world.ego, world.things = ego(7.5, 0.0), scenery(seed)
        self.truth = Truth(world, START_NS, {})
        self.points = [lidar_points(world, number * PERIOD_NS * 1e-9) for number in range(CLOUDS)]

    def record(self, path, *, header_ns=0, timed=True):
        """Write a recording whose headers come `header_ns` after the begin of each revolution."""
        end_ns = START_NS + CLOUDS * PERIOD_NS
        with ExitStack() as stack:
            recorder = open_recorder(path, "mcap", "none", stack)
            events = heapq.merge(
                motion_events(self.truth, end_ns),
                self._clouds(header_ns, timed),
                key=lambda one: one.log_time_ns,
            )
            for one in events:
                recorder.write(one.topic, one.msgtype, one.log_time_ns, one.make(recorder.messages))

    def _clouds(self, header_ns, timed):
        for number, points in enumerate(self.points):
            begin_ns = START_NS + number * PERIOD_NS
            sent = points if timed else repack_fields(points[["x", "y", "z", "intensity", "ring"]])
            make = partial(Messages.cloud, stamp_ns=begin_ns + header_ns, frame="lidar_top", points=sent)
            yield Event(begin_ns + 105 * MS, "/lidar_top/points", "sensor_msgs/msg/PointCloud2", make)


@pytest.fixture(scope="module")
def drives():
    """The drives of a seed, made when they are asked for."""
    made = {}

    def drive(seed, ego=Lively):
        if (seed, ego) not in made:
            made[seed, ego] = Drive(seed, ego)
        return made[seed, ego]

    return drive


def checked(folder, channel=""):
    """Build the recording in a folder, and return what the check of the catalogue finds."""
    (folder / "recipe.yaml").write_text(
        f"""
name: timed
bags: {{root: recordings}}
rigs:
  - name: car
    ego_pose: {{source: odometry, topic: /odom}}
    channels:
      LIDAR_TOP: {{modality: lidar, topic: /lidar_top/points{channel}}}
"""
    )
    recipe = load_recipe(folder / "recipe.yaml")
    (made,) = build_recordings(recipe).values()
    evidence = Evidence(recipe, recipe.rigs[0], Store(recipe.store_path), lambda asset: made[asset].artifact)
    (check,) = (check for check in RECORDING_CHECKS if check.name == "sweeps_timed")
    return check.rule(evidence)


def advice(problem):
    """What to write, from the end of the sentence."""
    return problem.rpartition("write ")[2]


@pytest.mark.parametrize("late_ms", [0, 50, -50, 100, -100])
def test_headers_that_are_late_by_a_known_time_are_found_and_mended(tmp_path, drives, late_ms):
    drives(1).record(tmp_path / "recordings" / "a.mcap", header_ns=late_ms * MS)
    finding = checked(tmp_path, ", deskew: true")
    assert finding.facts["LIDAR_TOP"]["best_offset_ms"] == pytest.approx(-late_ms, abs=5)
    if not late_ms:
        assert finding.problems == []
        return
    (problem,) = finding.problems
    assert f"ms {'before' if late_ms > 0 else 'after'} their stamps" in problem
    field, _, value = advice(problem).partition(": ")
    assert field == "stamp_offset_s"
    assert float(value) == pytest.approx(-late_ms / 1e3, abs=0.005)
    fixed = checked(tmp_path, f", deskew: true, {advice(problem)}")
    assert fixed.problems == []
    assert fixed.facts["LIDAR_TOP"]["best_offset_ms"] == pytest.approx(0, abs=5)


@pytest.mark.parametrize(
    ("seed", "header_ms", "meant"), [(9, 100, "end"), (3, 0, "start"), (3, 50, None), (9, 50, None)]
)
def test_what_the_header_of_clouds_without_point_times_means_is_said(
    tmp_path, drives, seed, header_ms, meant
):
    drives(seed).record(tmp_path / "recordings" / "a.mcap", header_ns=header_ms * MS, timed=False)
    finding = checked(tmp_path)
    if meant is None:
        assert finding.problems == []
        return
    (problem,) = finding.problems
    assert f"the stamps seem to mean the {meant} of a revolution" in problem
    assert advice(problem) == f"header_stamp_is: {meant}"
    assert checked(tmp_path, f", {advice(problem)}").problems == []


def test_what_the_recipe_says_wrongly_of_the_header_is_found(tmp_path, drives):
    drives(9).record(tmp_path / "recordings" / "a.mcap", header_ns=PERIOD_NS, timed=False)
    (problem,) = checked(tmp_path, ", header_stamp_is: start").problems
    assert advice(problem) == "header_stamp_is: end"


def test_a_car_that_moves_on_evenly_shows_nothing(tmp_path, drives):
    drives(1, Ego).record(tmp_path / "recordings" / "a.mcap", header_ns=PERIOD_NS)
    finding = checked(tmp_path, ", deskew: true")
    assert finding.passed
    assert finding.facts == {"LIDAR_TOP": "the motion of the vehicle changes too little to tell"}


# --- the rule by itself ----


RIG = Rig.model_validate(
    {
        "name": "car",
        "channels": {"LIDAR_TOP": {"modality": "lidar", "topic": "/points", "deskew": True}},
        "ego_pose": {"source": "odometry", "topic": "/odom"},
    }
)


def trajectory(world, seconds=CLOUDS / 10):
    times_s = np.arange(round(seconds * 50) + 1) * 0.02
    positions, rotations = world.ego.pose(times_s)
    return Trajectory(
        START_NS + np.round(times_s * 1e9).astype(np.int64), positions, rotations, 500 * MS, 200 * MS
    )


def sweeps(points, late_ms=0):
    """Clouds that were measured in one instant each."""
    stamps = START_NS + np.arange(len(points)) * PERIOD_NS + late_ms * MS
    return Sweeps(stamps, np.stack([stamps, stamps], axis=1), points.__getitem__, EGO_SE3_LIDAR)


@pytest.fixture(scope="module")
def instant():
    """Clouds of walls and poles around, each measured in one instant, and the way of the car."""
    world = World(0)
    world.ego = Lively(7.5, 0.0)
    dice = np.random.default_rng(5)
    corners = dice.uniform([-20, -25], [60, 45], (60, 2))
    walls = [
        np.stack([c[0] + np.cos(a) * s, c[1] + np.sin(a) * s, h], axis=1)
        for c, a in zip(corners, dice.uniform(0, np.pi, 60), strict=True)
        for s, h in [(dice.uniform(-2, 2, 400), dice.uniform(0, 3, 400))]
    ]
    standing = np.concatenate(walls)
    clouds = []
    for number in range(CLOUDS):
        odom_SE3_lidar = world.ego.at(number * 0.1) @ EGO_SE3_LIDAR
        seen = odom_SE3_lidar.inverse().transform_points(standing[dice.permutation(len(standing))[:8000]])
        clouds.append(np.pad(seen, ((0, 0), (0, 2))).astype(np.float32))
    return clouds, trajectory(world)


def found(clouds, way, late_ms=0, rig=RIG):
    return sweeps_timed(rig, {"LIDAR_TOP": sweeps(clouds, late_ms)}, way, SweepTimesCheck())


@pytest.mark.parametrize("late_ms", [0, 40, -60, 120, -150])
def test_clouds_of_an_instant_are_found_where_they_were_taken(instant, late_ms):
    finding = found(*instant, late_ms)
    assert finding.facts["LIDAR_TOP"]["best_offset_ms"] == pytest.approx(-late_ms, abs=8)
    assert finding.passed == (late_ms == 0)
    assert found(*instant, late_ms) == finding


@pytest.mark.filterwarnings("error")  # such as that of NaN cast to the number of a cell
@pytest.mark.parametrize("seconds", [1.6, 2.4])
def test_offsets_without_poses_fit_nowhere(instant, seconds):
    clouds, way = instant
    known = slice(50, 50 + round(seconds * 50))  # poses begin after the first cloud and end before the last
    short = replace(
        way,
        stamps_ns=way.stamps_ns[known],
        positions_m=way.positions_m[known],
        rotations=way.rotations[known],
        extrapolate_ns=0,
    )
    finding = found(clouds, short)
    assert finding.passed
    assert finding.facts["LIDAR_TOP"]["best_offset_ms"] == pytest.approx(0, abs=8)


@pytest.mark.parametrize("noise_m", [0.005, 0.02])
def test_noise_of_the_poses_is_no_finding(instant, noise_m):
    clouds, way = instant
    for seed in range(5):
        noise = np.random.default_rng(seed).normal(0, noise_m, way.positions_m.shape)
        noisy = replace(way, positions_m=way.positions_m + noise)
        assert found(clouds, noisy).passed
        assert not found(clouds, noisy, 100).passed


def test_what_fits_nowhere_is_no_finding(instant):
    clouds, way = instant
    assert found([clouds[3]] * CLOUDS, way).passed  # a lidar that repeats itself
    shuffled = np.random.default_rng(1).permutation(CLOUDS)
    assert found([clouds[number] for number in shuffled], way).passed
    jumping = way.positions_m.copy()
    jumping[100:] += [0.8, 0.3, 0.0]
    assert found(clouds, replace(way, positions_m=jumping)).passed


def test_where_nothing_can_be_compared_the_facts_say_why(instant):
    clouds, way = instant
    pose = Trajectory(way.stamps_ns[:1], way.positions_m[:1], way.rotations[:1], 0, 0, fixed=True)
    still = replace(
        way, positions_m=way.positions_m * 0, rotations=np.tile(way.rotations[:1], (len(way.rotations), 1))
    )
    reasons = {
        "the vehicle stands still, so there is nothing to compare": found(clouds, pose),
        "the motion of the vehicle changes too little to tell": found(clouds, still),
        "too few clouds to tell": found(clouds[:3], way),
        "too little stands upright around the vehicle to tell": found([cloud[:50] for cloud in clouds], way),
    }
    for reason, finding in reasons.items():
        assert (finding.problems, finding.facts) == ([], {"LIDAR_TOP": reason})
    flat = [cloud * np.float32([1, 1, 0, 1, 1]) for cloud in clouds]
    assert found(flat, way, 100).problems  # a scan of one plane shows walls only
    unreadable = Sweeps(**vars(sweeps(clouds)) | {"points": lambda number: None})
    finding = sweeps_timed(RIG, {"LIDAR_TOP": unreadable}, way, SweepTimesCheck())
    assert finding.facts == {"LIDAR_TOP": "too little stands upright around the vehicle to tell"}


def test_the_threshold_counts(instant):
    clouds, way = instant
    strict = SweepTimesCheck(min_gain=0.99)
    assert sweeps_timed(RIG, {"LIDAR_TOP": sweeps(clouds, 100)}, way, strict).passed


def test_only_lidars_are_looked_at(instant):
    clouds, way = instant
    radar = {"RADAR_FRONT": {"modality": "radar", "topic": "/radar"}}
    rig = Rig.model_validate(
        {"name": "car", "channels": radar, "ego_pose": {"source": "odometry", "topic": "/odom"}}
    )
    given = {"RADAR_FRONT": sweeps(clouds, 100), "LIDAR_TOP": sweeps(clouds, 100)}
    assert sweeps_timed(rig, given, way, SweepTimesCheck()).facts == {}
