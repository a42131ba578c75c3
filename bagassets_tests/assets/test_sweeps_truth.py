"""A world with known surfaces, seen by a spinning lidar on a turning vehicle.

What the step writes must lie on the surfaces: deskewed, stamped, in the frame of the sensor, from
raw packets as well as from clouds.
"""

import numpy as np
import pytest

from bagassets.geometry.se3 import SE3, rotate
from bagassets.geometry.trajectory import Trajectory
from bagassets_tests.sweep_data import (
    PACKET_TYPE,
    VLP16_ELEVATIONS,
    VLP16_PACKET_NS,
    cloud,
    raw,
    velodyne_scan,
    vlp16_packets,
)
from bagassets_tests.sweep_run import CLOUD, PERIOD_NS, SCAN, START_NS, Runner, lidar, request

SPEED, YAW_RATE = 12.0, 0.6  # m/s, rad/s: a sharp turn
TURNS = 3
BOX_LOW, BOX_HIGH = np.array([8.0, -6.0, 0.0]), np.array([12.0, -3.0, 4.0])  # a parked van, in the world
MOUNT = {
    "translation": [1.5, 0.2, 1.9],
    "rotation": [float(np.cos(0.35)), 0.0, 0.0, float(np.sin(0.35))],
}  # looks 40 degrees to the left
EGO_SE3_SENSOR = SE3.create(MOUNT["rotation"], MOUNT["translation"])


def poses(times_ns):
    """Positions and rotations on a circle, in closed form."""
    t = (np.asarray(times_ns) - START_NS) * 1e-9
    radius = SPEED / YAW_RATE
    yaw = YAW_RATE * t
    positions = np.stack([radius * np.sin(yaw), radius * (1 - np.cos(yaw)), 0 * t], axis=1)
    return positions, np.stack([np.cos(yaw / 2), 0 * t, 0 * t, np.sin(yaw / 2)], axis=1)


def trajectory():
    stamps = START_NS - 40_000_000 + np.arange(30) * 20_000_000  # 50 Hz
    positions, rotations = poses(stamps)
    return Trajectory(stamps, positions, rotations, max_gap_ns=10**9, extrapolate_ns=0)


def to_world(points, times_ns):
    """Sensor frame at the time of each point -> world."""
    positions, rotations = poses(times_ns)
    return rotate(rotations, EGO_SE3_SENSOR.transform_points(points)) + positions


def first_hits(directions, times_ns):
    """Distance along each ray from the sensor to the ground or the van, 0 for none within 60 m."""
    origins = to_world(np.zeros_like(directions), times_ns)
    rays = to_world(directions, times_ns) - origins
    with np.errstate(divide="ignore", invalid="ignore"):
        ground = np.where(rays[:, 2] < 0, -origins[:, 2] / rays[:, 2], np.inf)
        low, high = (BOX_LOW - origins) / rays, (BOX_HIGH - origins) / rays
    enter = np.minimum(low, high).max(axis=1)
    leave = np.maximum(low, high).min(axis=1)
    van = np.where((enter > 0) & (enter < leave), enter, np.inf)
    distance = np.minimum(ground, van)
    hit = distance < 60
    return np.where(hit, distance, 0.0), hit & (van <= ground)


def rays():
    """Directions in the sensor frame and times of all shots of a VLP-16, by packet, firing, laser."""
    number = len(vlp16_packets(TURNS))
    firing = np.arange(24) * 55_296
    shot_ns = np.arange(number)[:, None, None] * VLP16_PACKET_NS + firing[:, None] + np.arange(16) * 2_304
    azimuth = np.radians(shot_ns * 1e-9 * 3600)
    elevation = np.radians(np.broadcast_to(VLP16_ELEVATIONS, shot_ns.shape))
    directions = np.stack(
        [
            np.cos(elevation) * np.cos(azimuth),
            -np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ],
        axis=-1,
    )
    return directions.reshape(-1, 3), START_NS + shot_ns.reshape(-1)


def as_packets():
    directions, times = rays()
    distance, _ = first_hits(directions, times)
    packets = vlp16_packets(TURNS)
    packets["blocks"]["returns"]["distance"] = np.rint(distance / 0.002).reshape(len(packets), 12, 32)
    yield raw(velodyne_scan(packets, START_NS, VLP16_PACKET_NS), SCAN, START_NS)


def as_clouds():
    directions, times = rays()
    distance, _ = first_hits(directions, times)
    for turn in range(TURNS):
        begin = START_NS + turn * PERIOD_NS
        chosen = (times >= begin) & (times < begin + PERIOD_NS) & (distance > 0)
        points = directions[chosen] * distance[chosen, None]
        columns = {axis: points[:, column].astype(np.float32) for column, axis in enumerate("xyz")}
        yield raw(cloud(begin, columns | {"t": (times[chosen] - begin).astype(np.uint32)}), CLOUD, begin)


def off_the_surfaces(world):
    """Distance of points to the nearer of ground and van, in metres."""
    outside = np.maximum(np.maximum(BOX_LOW - world, world - BOX_HIGH), 0.0)
    inside = np.minimum(world - BOX_LOW, BOX_HIGH - world).min(axis=1)
    to_van = np.where(inside > 0, inside, np.linalg.norm(outside, axis=1))
    return np.minimum(np.abs(world[:, 2]), to_van)


def in_the_world(result, row):
    stamp = result.index[row]["stamp_ns"]
    points = result.points(row)[:, :3].astype(float)
    return to_world(points, np.full(len(points), stamp))


def in_the_van(world, margin):
    return ((world > BOX_LOW - margin) & (world < BOX_HIGH + margin)).all(axis=1) & (world[:, 2] > 0.1)


@pytest.fixture
def run(tmp_path):
    return Runner(tmp_path)


@pytest.mark.parametrize("stamp", ["start", "middle", "end"])
@pytest.mark.parametrize(
    ("msgtype", "messages", "accuracy_m"),
    [
        (CLOUD, as_clouds, 0.002),
        (SCAN, as_packets, 0.02),  # azimuths of 0.01 degrees, lasers up to 11 mm above the origin
    ],
)
def test_deskewed_points_lie_on_the_true_surfaces(run, msgtype, messages, accuracy_m, stamp):
    asked = request(lidar(deskew=True, stamp=stamp), msgtype, mount=MOUNT, poses="p")
    result = run(asked, messages(), trajectory())
    assert len(result.index) == TURNS
    directions, times = rays()
    _, on_van = first_hits(directions, times)
    for row in range(TURNS):
        world = in_the_world(result, row)
        assert len(world) > 8_000
        assert off_the_surfaces(world).max() < accuracy_m
        # As many points in the van's box as there were rays that hit it.
        begin = START_NS + row * PERIOD_NS
        hits = on_van[(times >= begin) & (times < begin + PERIOD_NS)].sum()
        assert in_the_van(world, accuracy_m).sum() == pytest.approx(hits, rel=0.05)


def test_without_deskewing_the_same_points_are_off_by_what_the_vehicle_moved(run):
    result = run(request(lidar(), CLOUD), as_clouds())
    world = in_the_world(result, 1)
    assert np.quantile(off_the_surfaces(world[in_the_van(world, 2.0)]), 0.9) > 0.1


def test_packets_and_clouds_agree(run):
    packets = run(request(lidar(deskew=True), SCAN, mount=MOUNT, poses="p"), as_packets(), trajectory())
    clouds = run(request(lidar(deskew=True), CLOUD, mount=MOUNT, poses="p"), as_clouds(), trajectory())
    for one, other in zip(packets.index, clouds.index, strict=True):
        assert abs(one["stamp_ns"] - other["stamp_ns"]) < VLP16_PACKET_NS
        assert abs(one["points"] - other["points"]) < 0.02 * one["points"]


def test_the_world_is_what_it_should_be():
    directions, times = rays()
    distance, on_van = first_hits(directions, times)
    assert on_van.sum() > 300
    assert (distance > 0).sum() > 3 * 8_000
    world = to_world(directions * distance[:, None], times)[distance > 0]
    assert off_the_surfaces(world).max() < 1e-9
    assert PACKET_TYPE.itemsize == 1206
