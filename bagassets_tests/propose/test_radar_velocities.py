"""Radar velocities: what is relative to the radar is compensated for its motion, and nothing else is.

The truth is a closed form: the vehicle drives a circle at a constant speed, and targets stand or move evenly.
"""

import json
from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import pytest

from bagassets.assets import sweeps
from bagassets.assets.asset import as_json
from bagassets.assets.radar_file import read_radar_file
from bagassets.assets.sweeps import SWEEPS
from bagassets.geometry.radar_motion import sensor_velocities
from bagassets.geometry.se3 import SE3
from bagassets.geometry.trajectory import Trajectory
from bagassets.recipe.model import RadarChannel, Recipe
from bagassets_tests.sweep_data import Header, cloud, header, raw
from bagassets_tests.sweep_run import CLOUD, START_NS, Runner, inventory, request

pytestmark = pytest.mark.once

SPEED_MPS, YAW_RATE = 12.0, 0.3
RADIUS_M = SPEED_MPS / YAW_RATE
MOUNT_YAW, MOUNT_M = 0.8, (3.4, 0.7, 0.5)
MOUNT = {"translation": list(MOUNT_M), "rotation": [np.cos(MOUNT_YAW / 2), 0.0, 0.0, np.sin(MOUNT_YAW / 2)]}
ESR, SCAN = "delphi_esr_msgs/msg/EsrTrack", "radar_msgs/msg/RadarScan"
# Places (m) and velocities (m/s) over ground in the global frame: two stand, two move.
PLACES = np.array([[20.0, 30.0, 0.5], [30.0, 12.0, 2.0], [25.0, 25.0, 0.5], [15.0, 35.0, 0.5]])
VELOCITIES = np.array([[0.0, 0.0], [0.0, 0.0], [-7.0, 4.0], [3.0, 9.0]])


def turned(yaw, vectors):
    c, s = np.cos(yaw), np.sin(yaw)
    return np.stack(
        [c * vectors[..., 0] - s * vectors[..., 1], s * vectors[..., 0] + c * vectors[..., 1]], -1
    )


def heading(seconds):
    return YAW_RATE * seconds


def ego_m(seconds):
    yaw = heading(seconds)
    return np.stack([RADIUS_M * np.sin(yaw), RADIUS_M * (1 - np.cos(yaw))], -1)


def circle(first_s=-1.0, last_s=2.0, **fields):
    """`global_SE3_ego` on the circle, every 20 ms."""
    seconds = np.arange(round(first_s * 50), round(last_s * 50) + 1) / 50
    yaw = heading(seconds)
    rotations = np.zeros((len(yaw), 4))
    rotations[:, 0], rotations[:, 3] = np.cos(yaw / 2), np.sin(yaw / 2)
    positions = np.zeros((len(yaw), 3))
    positions[:, :2] = ego_m(seconds)
    stamps = START_NS + np.round(seconds * 1e9).astype(np.int64)
    limits = {"max_gap_ns": 500_000_000, "extrapolate_ns": 50_000_000} | fields
    return Trajectory(stamps, positions, rotations, **limits)


def seen(seconds):
    """What the radar sees, in its frame: places, velocities over ground, velocities relative to it."""
    yaw = heading(seconds) + MOUNT_YAW
    radar_m = ego_m(seconds) + turned(heading(seconds), np.array(MOUNT_M[:2]))
    moved = PLACES[:, :2] + VELOCITIES * seconds
    places = np.column_stack([turned(-yaw, moved - radar_m), PLACES[:, 2] - MOUNT_M[2]])
    # v + omega x r, by hand
    own = np.array([SPEED_MPS - YAW_RATE * MOUNT_M[1], YAW_RATE * MOUNT_M[0]])
    radar_mps = turned(heading(seconds), own)
    return places, turned(-yaw, VELOCITIES), turned(-yaw, VELOCITIES - radar_mps)


def columns(seconds, *, radial=False, over_ground=False, compensated=False):
    places, ground, relative = seen(seconds)
    told = {axis: places[:, i] for i, axis in enumerate("xyz")}
    if radial:
        rays = places / np.linalg.norm(places, axis=1)[:, None]
        told["range_rate"] = (rays[:, :2] * relative).sum(axis=1)
    else:
        told["vx"], told["vy"] = (ground if over_ground else relative).T
    if compensated:
        told["vx_comp"], told["vy_comp"] = np.full((2, len(PLACES)), 77.0)
    return told


def clouds(times_s=(0.0, 0.4, 0.8), **kind):
    for seconds in times_s:
        stamp = START_NS + round(seconds * 1e9)
        yield raw(cloud(stamp, columns(seconds, **kind), "radar"), CLOUD, stamp + 5)


def asked(velocities=None, msgtype=CLOUD, **fields):
    return request(RadarChannel(topic="/sensor", velocities=velocities), msgtype, mount=MOUNT, **fields)


@pytest.fixture
def run(tmp_path):
    return Runner(tmp_path)


def targets(result):
    return [read_radar_file(result.files / row["file"]) for row in result.index]


def pair(table, suffix=""):
    return np.column_stack([table[f"vx{suffix}"], table[f"vy{suffix}"]])


def test_the_velocity_of_the_mount_is_that_of_the_circle():
    stamps = START_NS + np.array([0, 400_000_000, 777_000_001])
    mount = SE3(tuple(MOUNT["rotation"]), MOUNT_M)
    own = np.array([SPEED_MPS - YAW_RATE * MOUNT_M[1], YAW_RATE * MOUNT_M[0]])
    expected = [*turned(-MOUNT_YAW, own), 0.0]
    assert np.allclose(sensor_velocities(circle(), mount, stamps), expected, atol=3e-3)


def test_near_the_ends_of_the_poses_what_there_is_counts():
    mount = SE3(tuple(MOUNT["rotation"]), MOUNT_M)
    ends = circle(0.0, 1.0)
    stamps = START_NS + np.array([-40_000_000, 0, 30_000_000, 1_000_000_000, 1_040_000_000, 1_060_000_000])
    found = sensor_velocities(ends, mount, stamps)
    truth = sensor_velocities(circle(), mount, stamps)
    assert np.allclose(found[1:4], truth[1:4], atol=2e-3)
    assert np.allclose(found[[0, 4]], truth[[0, 4]], atol=0.08)  # extrapolated poses go straight on
    assert np.isnan(found[5]).all()


def test_no_velocity_is_measured_across_a_gap():
    whole = circle()
    keep = np.abs((whole.stamps_ns - START_NS) / 1e9 - 0.5) > 0.3
    holed = Trajectory(
        whole.stamps_ns[keep], whole.positions_m[keep] + (whole.stamps_ns[keep] > START_NS + 5e8)[:, None] * 50,
        whole.rotations[keep], 100_000_000, 0,
    )  # fmt: skip
    stamps = START_NS + np.array([150_000_000, 500_000_000, 850_000_000])
    found = sensor_velocities(holed, SE3(), stamps)
    assert np.allclose(np.linalg.norm(found[[0, 2]], axis=1), SPEED_MPS, atol=0.05)
    assert np.isnan(found[1]).all()


def test_a_rig_that_stands_still_does_not_move():
    fixed = Trajectory(np.array([0]), np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]]), 0, 0, fixed=True)
    assert sensor_velocities(fixed, SE3(), np.array([START_NS])).tolist() == [[0.0, 0.0, 0.0]]


def test_relative_velocities_are_compensated_at_the_mount(run):
    result = run(asked("relative"), clouds(), circle())
    for seconds, table in zip((0.0, 0.4, 0.8), targets(result), strict=True):
        _, ground, relative = seen(seconds)
        assert np.allclose(pair(table), relative, atol=1e-5)
        assert np.allclose(pair(table, "_comp"), ground, atol=5e-3)
    assert result.lost == {}


def test_radial_velocities_are_compensated_along_the_ray(run):
    result = run(asked("relative"), clouds(radial=True), circle())
    for seconds, table in zip((0.0, 0.4, 0.8), targets(result), strict=True):
        places, ground, _ = seen(seconds)
        rays = places / np.linalg.norm(places, axis=1)[:, None]
        radial = (rays[:, :2] * ground).sum(axis=1)
        assert np.allclose(pair(table, "_comp"), radial[:, None] * rays[:, :2], atol=5e-3)
        assert np.abs(pair(table, "_comp")[:2]).max() < 5e-3
        assert np.abs(pair(table)[:2]).max() > 5.0


def test_a_radar_that_rises_is_compensated_along_rays_that_point_up(run):
    seconds = np.arange(-50, 100) / 50
    positions = np.zeros((150, 3))
    positions[:, 2] = 3.0 * seconds
    stamps = START_NS + np.round(seconds * 1e9).astype(np.int64)
    rising = Trajectory(stamps, positions, np.tile([1.0, 0, 0, 0], (150, 1)), 500_000_000, 0)
    told = {
        "x": np.array([8.0]),
        "y": np.array([0.0]),
        "z": np.array([6.0]),
        "range_rate": np.array([-3.0 * 0.6]),
    }
    (table,) = targets(run(asked("relative"), [raw(cloud(START_NS, told, "radar"), CLOUD, START_NS)], rising))
    assert np.abs(pair(table, "_comp")).max() < 1e-6
    assert abs(table["vx"][0]) > 1.0


@dataclass
class Return:
    range: float
    azimuth: float
    elevation: float
    doppler_velocity: float


@dataclass
class Scan:
    header: Header
    returns: list = field(default_factory=list)


@dataclass
class Track:
    header: Header
    track_id: int
    track_range: float
    track_angle: float
    track_range_rate: float


def by_definition(msgtype):
    """Messages of a type that is defined to be relative; angles to the left in radians, or to the right in degrees."""
    places, _, relative = seen(0.0)
    distance = np.linalg.norm(places, axis=1)
    doppler = (places[:, :2] * relative).sum(axis=1) / distance
    angle = np.arctan2(places[:, 1], places[:, 0])
    if msgtype == SCAN:
        up = np.arcsin(places[:, 2] / distance)
        returns = [Return(*values) for values in zip(distance, angle, up, doppler, strict=True)]
        return [raw(Scan(header(START_NS, "radar"), returns), SCAN, START_NS)]
    return [
        raw(Track(header(START_NS, "radar"), n, float(distance[n]), -float(np.degrees(angle[n])), float(doppler[n])), ESR, START_NS)
        for n in range(len(places))
    ]  # fmt: skip


@pytest.mark.parametrize("msgtype", [SCAN, ESR])
def test_what_a_type_defines_needs_no_word_in_the_recipe(run, msgtype):
    (table,) = targets(run(asked(None, msgtype), by_definition(msgtype), circle()))
    places, _, _ = seen(0.0)
    flat = (
        msgtype == ESR
    )  # these have no elevation: the target 1.5 m above the radar seems 0.05 m farther off
    assert np.allclose(table["y"], places[:, 1], atol=0.06 if flat else 1e-4)
    assert np.abs(pair(table, "_comp")[:2]).max() < (0.03 if flat else 5e-3)
    assert np.linalg.norm(pair(table), axis=1)[:2].min() > 5.0


def test_the_recipe_outweighs_the_definition(run):
    (table,) = targets(run(asked("over_ground", SCAN), by_definition(SCAN)))
    assert pair(table, "_comp").tolist() == pair(table).tolist()


@pytest.mark.parametrize("velocities", [None, "over_ground"])
def test_velocities_over_ground_stay_as_they_are(run, velocities):
    for table in targets(run(asked(velocities), clouds(over_ground=True))):
        assert pair(table, "_comp").tolist() == pair(table).tolist()


@pytest.mark.parametrize("velocities", [None, "over_ground"])
def test_recorded_compensation_stays(run, velocities):
    for table in targets(run(asked(velocities), clouds(compensated=True))):
        assert (pair(table, "_comp") == 77.0).all()


def test_the_recipe_replaces_a_compensation_that_is_wrong(run):
    table = targets(run(asked("relative"), clouds(compensated=True), circle()))[0]
    assert np.allclose(pair(table, "_comp"), seen(0.0)[1], atol=5e-3)


def test_a_radar_without_velocities_gets_none(run):
    message = raw(cloud(START_NS, {axis: np.ones(2) for axis in "xyz"}, "radar"), CLOUD, START_NS)
    (table,) = targets(run(asked("relative"), [message], circle()))
    assert not pair(table, "_comp").any()


def test_unknown_numbers_stay_unknown(run):
    told = columns(0.0)
    told["vx"][2] = np.nan
    (table,) = targets(
        run(asked("relative"), [raw(cloud(START_NS, told, "radar"), CLOUD, START_NS)], circle())
    )
    assert (table["vx"][2], table["vx_comp"][2]) == (0.0, 0.0)
    assert np.abs(pair(table, "_comp")[:2]).max() < 5e-3


def test_a_reading_without_a_pose_is_counted_as_lost(run):
    result = run(asked("relative"), clouds(), circle(0.3, 0.5))
    assert result.lost == {"no ego pose to compensate with": 2}
    (table,) = targets(result)
    assert np.abs(pair(table, "_comp")[:2]).max() < 5e-3


def test_a_reading_without_velocities_needs_no_pose(run):
    message = raw(cloud(START_NS, {axis: np.ones(2) for axis in "xyz"}, "radar"), CLOUD, START_NS)
    assert run(asked("relative"), [message], circle(0.3, 0.5)).lost == {}


def test_the_log_clock_is_that_of_the_poses(run):
    late = [raw(one.data.message, CLOUD, one.log_time_ns + 10**9) for one in clouds((0.0,))]
    shifted = circle()
    shifted = Trajectory(
        shifted.stamps_ns + 10**9 + 5, shifted.positions_m, shifted.rotations, 500_000_000, 0
    )
    (table,) = targets(run(asked("relative", clock="log"), late, shifted))
    assert np.allclose(pair(table, "_comp"), seen(0.0)[1], atol=5e-3)


# --- what runs again ---------------------------------------------------------------------


def waits_for(velocities, msgtype):
    channels = {"RADAR_FRONT": RadarChannel(topic="/sensor", velocities=velocities)}
    rig = {"name": "car", "channels": channels, "ego_pose": {"source": "fixed"}}
    recipe = Recipe(name="test", bags={"root": "bags"}, rigs=(rig,))
    return SWEEPS.needs(SWEEPS.params(recipe, recipe.rigs[0]), msgtype and inventory(msgtype))


@pytest.mark.parametrize("velocities", [None, "over_ground"])
def test_keys_of_radars_that_need_no_poses_are_as_before(velocities):
    use = asked(velocities)
    assert use.inputs == {}
    assert set(as_json(use.params)) == {
        "channel", "modality", "msgtype", "topic", "clock", "lost_messages", "azimuth_positive",
    }  # fmt: skip
    assert SWEEPS.action(use, _Inventory()).digest == (
        SWEEPS.action(asked(None, poses="others"), _Inventory()).digest
    )


class _Inventory:
    def digests(self, topics):
        return dict.fromkeys(topics, "d")


@pytest.mark.parametrize(("velocities", "msgtype"), [("relative", CLOUD), (None, SCAN), (None, ESR)])
def test_poses_and_mount_count_where_they_compensate(velocities, msgtype):
    use = asked(velocities, msgtype)
    assert use.inputs == {"ego_poses": "p"}
    assert as_json(use.params)["ego_SE3_sensor"] == MOUNT
    json.dumps(as_json(use.params))


def test_a_plug_in_gives_types_a_meaning_of_its_own(monkeypatch):
    of_acme = SimpleNamespace(family="radar", plugin="acme", key={"distribution": "acme", "version": "1"})
    monkeypatch.setattr(sweeps, "require_decoder", lambda *_: of_acme)
    assert asked(None, SCAN).inputs == {}
    assert asked("relative", SCAN).inputs == {"ego_poses": "p"}


def test_poses_are_made_before_only_where_they_compensate():
    assert "ego_poses" in waits_for("relative", CLOUD)
    assert "ego_poses" in waits_for(None, SCAN)
    assert "ego_poses" not in waits_for(None, CLOUD)
    assert "ego_poses" not in waits_for("over_ground", SCAN)
    assert "ego_poses" not in waits_for(None, None)  # what it waits for first is the inventory
    assert "inventory" in waits_for(None, None)


def test_the_code_version_changes_with_the_recipe():
    params = {}
    for velocities in (None, "relative", "over_ground"):
        channels = {"RADAR_FRONT": RadarChannel(topic="/sensor", velocities=velocities)}
        recipe = Recipe(
            name="t",
            bags={"root": "b"},
            rigs=({"name": "c", "channels": channels, "ego_pose": {"source": "fixed"}},),
        )
        params[velocities] = as_json(SWEEPS.params(recipe, recipe.rigs[0]))["radars"]["RADAR_FRONT"]
    assert "velocities" not in params[None]
    assert params["relative"]["velocities"] == "relative"
    assert params["over_ground"]["velocities"] == "over_ground"
