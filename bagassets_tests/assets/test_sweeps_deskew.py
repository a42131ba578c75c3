"""Deskewing: a wall seen from a moving sensor is flat again."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bagassets.assets.lidar_sweeps import deskew
from bagassets.geometry.se3 import SE3
from bagassets.geometry.trajectory import Trajectory

START_NS = 1_700_000_000_000_000_000
TURN_NS = 100_000_000


def deskewed(points, *args):
    moved = points.copy()
    assert deskew(moved, *args)
    return moved


def quaternion(axis, angle):
    axis = np.asarray(axis, float) / np.linalg.norm(axis)
    return np.array([np.cos(angle / 2), *(np.sin(angle / 2) * axis)])


def trajectory(velocity, axis, rate, *, period_ns=10_000_000, before_ns=TURN_NS, after_ns=TURN_NS, **options):
    """Uniform motion, sampled as odometry does."""
    stamps = np.arange(START_NS - before_ns, START_NS + TURN_NS + after_ns + 1, period_ns)
    seconds = (stamps - START_NS) * 1e-9
    positions = np.array([100.0, -50.0, 2.0]) + seconds[:, None] * np.asarray(velocity)
    rotations = np.array([quaternion(axis, 0.3 + rate * t) for t in seconds])
    settings_ = {"max_gap_ns": 500_000_000, "extrapolate_ns": 0} | options
    return Trajectory(stamps, positions, rotations, **settings_)


def global_SE3_sensor(path, ego_SE3_sensor, stamp_ns):
    positions, rotations, _ = path.at(np.array([stamp_ns]))
    return SE3.create(rotations[0], positions[0]) @ ego_SE3_sensor


@settings(max_examples=40, deadline=None)
@given(
    velocity=st.tuples(st.floats(-30, 30), st.floats(-5, 5), st.floats(-1, 1)),
    axis=st.sampled_from([(0, 0, 1), (0, 1, 0.2), (1, 0.3, -0.5)]),
    rate=st.floats(-1.5, 1.5),
    fraction=st.sampled_from([0.0, 0.5, 1.0]),
    seed=st.integers(0, 1000),
)
def test_points_come_back_to_where_they_are_within_a_millimetre(velocity, axis, rate, fraction, seed):
    rng = np.random.default_rng(seed)
    path = trajectory(velocity, axis, rate)
    ego_SE3_sensor = SE3.create(quaternion((0.1, 1, 0.3), 0.2), (1.2, -0.3, 1.8))
    truth = rng.uniform(-80, 80, (40, 3)) + np.array([100.0, -50.0, 2.0])  # in the world
    times = START_NS + rng.integers(0, TURN_NS + 1, 40)
    seen = [
        global_SE3_sensor(path, ego_SE3_sensor, int(t)).inverse().transform_points(point[None, :])[0]
        for t, point in zip(times, truth, strict=True)
    ]
    points = np.zeros((40, 5), np.float32)
    points[:, :3] = seen
    points[:, 3:] = rng.integers(0, 100, (40, 2))
    stamp = START_NS + round(fraction * TURN_NS)
    moved = deskewed(points, times, stamp, path, ego_SE3_sensor)
    back = global_SE3_sensor(path, ego_SE3_sensor, stamp).transform_points(moved[:, :3].astype(float))
    assert np.linalg.norm(back - truth, axis=1).max() < 1e-3
    assert np.array_equal(moved[:, 3:], points[:, 3:])


def test_points_at_the_stamp_stay():
    path = trajectory((20, 0, 0), (0, 0, 1), 1.0)
    points = np.array([[10, 20, 1, 5, 3]], np.float32)
    moved = deskewed(points, np.array([START_NS + TURN_NS]), START_NS + TURN_NS, path, SE3())
    assert np.allclose(moved, points, atol=1e-6)


def test_a_rig_that_stands_still_needs_no_deskewing():
    path = Trajectory(
        np.array([0]),
        np.zeros((1, 3)),
        np.array([[1.0, 0, 0, 0]]),
        max_gap_ns=1,
        extrapolate_ns=0,
        fixed=True,
    )
    points = np.random.default_rng(0).normal(size=(10, 5)).astype(np.float32)
    times = START_NS + np.arange(10) * 1_000_000
    assert np.allclose(deskewed(points, times, START_NS, path, SE3()), points)


@pytest.mark.parametrize(
    "options",
    [
        {"before_ns": -50_000_000},  # poses begin in the middle of the revolution
        {"after_ns": -50_000_000},
        {"period_ns": 60_000_000, "max_gap_ns": 30_000_000},
    ],
)
def test_without_a_pose_at_every_time_points_stay_as_they_are(options):
    path = trajectory((20, 0, 0), (0, 0, 1), 1.0, **options)
    times = np.linspace(START_NS, START_NS + TURN_NS, 20).astype(np.int64)
    points = np.ones((20, 5), np.float32)
    assert not deskew(points, times, START_NS + TURN_NS, path, SE3())
    assert (points == 1).all()


def test_the_last_pose_is_used_to_its_end():
    path = trajectory((20, 0, 0), (0, 0, 1), 1.0, after_ns=0)  # the last pose is at the stamp
    times = np.linspace(START_NS, START_NS + TURN_NS, 20).astype(np.int64)
    assert deskew(np.zeros((20, 5), np.float32), times, START_NS + TURN_NS, path, SE3())


def test_no_points_need_no_poses():
    path = trajectory((0, 0, 0), (0, 0, 1), 0.0)
    assert deskewed(np.zeros((0, 5), np.float32), np.zeros(0, np.int64), 0, path, SE3()).shape == (0, 5)


def test_a_kink_in_the_trajectory_costs_less_than_a_millimetre():
    stamps = START_NS + np.array([-10, 10, 30, 50]) * 1_000_000 + 400_000
    positions = np.array([[0.0, 0, 0], [0.2, 0, 0], [0.42, 0, 0], [0.62, 0, 0]])  # 10, 11, 10 m/s
    rotations = np.tile([1.0, 0, 0, 0], (4, 1))
    path = Trajectory(stamps, positions, rotations, max_gap_ns=10**9, extrapolate_ns=0)
    times = START_NS + np.arange(0, 50_000_000, 37_000)
    truth = np.array([30.0, 0.0, 0.0])
    points = np.zeros((len(times), 5), np.float32)
    points[:, :3] = truth - path.at(times)[0]
    moved = deskewed(points, times, START_NS, path, SE3())
    assert np.abs(moved[:, :3] + path.at(np.array([START_NS]))[0] - truth).max() < 1e-3
