"""Radar velocities against the poses: a wrong setting is found in either direction, and traffic is not taken for one."""

import numpy as np
import pytest

from bagassets.assets.quality.sweep_rules import radar_velocities
from bagassets.geometry.se3 import SE3
from bagassets.geometry.trajectory import Trajectory

pytestmark = pytest.mark.once

START_NS, READINGS = 1_750_000_000_000_000_000, 30
MOUNT_YAW = 0.8
MOUNT = SE3((np.cos(MOUNT_YAW / 2), 0.0, 0.0, np.sin(MOUNT_YAW / 2)), (3.4, 0.7, 0.5))
DICE = np.random.default_rng(8)


def straight(speed_mps):
    stamps = START_NS + np.arange(-10, 200) * 20_000_000
    positions = np.zeros((len(stamps), 3))
    positions[:, 0] = (stamps - START_NS) * 1e-9 * speed_mps
    return Trajectory(stamps, positions, np.tile([1.0, 0, 0, 0], (len(stamps), 1)), 500_000_000, 0)


def in_radar(vectors):
    c, s = np.cos(MOUNT_YAW), np.sin(MOUNT_YAW)
    return np.stack(
        [c * vectors[..., 0] + s * vectors[..., 1], c * vectors[..., 1] - s * vectors[..., 0]], -1
    )


def scene(still, moving_mps=()):
    """Places around the radar, and velocities over ground in the frame of the vehicle: so many stand still."""
    velocities = np.zeros((still + len(moving_mps), 2))
    velocities[still:] = np.asarray(moving_mps, dtype=float).reshape(-1, 2)
    angles = DICE.uniform(-1.0, 1.0, len(velocities))
    distances = DICE.uniform(8.0, 60.0, len(velocities))
    places = np.column_stack([distances * np.cos(angles), distances * np.sin(angles)])
    return places, in_radar(velocities) + DICE.normal(0, 0.05, (len(velocities), 2))


def found(speed_mps, scenes, offset=0.0, radial=False, readings=READINGS):
    """The finding about readings whose velocities over ground are off by `offset` times that of the radar."""
    told = []
    for number in range(readings):
        places, velocities = scenes(number)
        written = velocities + offset * in_radar(np.array([speed_mps, 0.0]))
        if radial:
            rays = places / np.linalg.norm(places, axis=1)[:, None]
            written = (written * rays).sum(axis=1)[:, None] * rays
        stamp_ns = START_NS + number * 77_000_000
        told.append((stamp_ns, np.vstack([places.T, np.zeros(len(places)), written.T])))
    return radar_velocities({"RADAR_LEFT": (MOUNT, told)}, straight(speed_mps))


def parked(number):
    return scene(12, [(5.0, 0.5), (-9.0, 0.0)])


@pytest.mark.parametrize("radial", [False, True])
def test_still_things_that_stand_still_are_right(radial):
    assert found(12.0, parked, radial=radial).passed


@pytest.mark.parametrize("radial", [False, True])
def test_uncompensated_velocities_are_found(radial):
    (problem,) = found(12.0, parked, offset=-1.0, radial=radial).problems
    assert "RADAR_LEFT" in problem
    assert "write velocities: relative" in problem


@pytest.mark.parametrize("radial", [False, True])
def test_velocities_compensated_twice_are_found(radial):
    (problem,) = found(12.0, parked, offset=1.0, radial=radial).problems
    assert "write velocities: over_ground" in problem


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("still", [0, 3])
def test_traffic_that_moves_alike_is_traffic(sign, still):
    """A column around the car, or one that comes towards it, each vehicle at a speed of its own."""

    def column(number):
        speeds = sign * (12.0 + DICE.normal(0, 1.0, 12))
        return scene(still, np.column_stack([speeds, DICE.normal(0, 0.2, 12)]))

    assert found(12.0, column).passed


@pytest.mark.parametrize("speed_mps", [12.0, -12.0])
def test_standing_things_beside_a_tight_column_outweigh_it(speed_mps):
    """Everything in the column drives at exactly the speed of the car."""
    assert found(12.0, lambda _: scene(5, [(speed_mps, 0.0)] * 10)).passed


def test_a_few_readings_in_traffic_do_not_count():
    """A column at exactly the speed of the car, in a third of the readings."""

    def now_and_then(number):
        return scene(1, [(12.0, 0.0)] * 14) if number % 3 == 0 else parked(number)

    assert found(12.0, now_and_then).passed


@pytest.mark.parametrize(("speed_mps", "scenes"), [(0.5, parked), (12.0, lambda _: scene(2))])
def test_without_motion_or_targets_nothing_is_said(speed_mps, scenes):
    assert found(speed_mps, scenes, offset=-1.0).passed


def test_a_target_at_the_radar_itself_says_nothing():
    def with_one_at_zero(number):
        places, velocities = parked(number)
        places[0] = 0.0
        return places, velocities

    assert found(12.0, with_one_at_zero).passed
    assert not found(12.0, with_one_at_zero, offset=-1.0).passed


def test_a_handful_of_readings_is_not_enough():
    assert found(12.0, parked, offset=-1.0, readings=9).passed
    assert found(12.0, parked, readings=0).passed
