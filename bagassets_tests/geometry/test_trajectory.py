"""Interpolation of poses: end points, constant speed, shortest arc, gaps, ends."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bagassets.geometry.se3 import SE3, quaternion_multiply
from bagassets.geometry.trajectory import Trajectory, slerp

SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND

numbers = st.floats(-1.0, 1.0, allow_nan=False)
quaternions = (
    st.tuples(numbers, numbers, numbers, numbers)
    .filter(lambda q: sum(v * v for v in q) > 0.01)
    .map(lambda q: np.array(SE3.create(q, (0, 0, 0)).rotation))
)
fractions = st.floats(0.0, 1.0)


def about_z(angle_rad: float) -> list[float]:
    return [math.cos(angle_rad / 2), 0.0, 0.0, math.sin(angle_rad / 2)]


def straight(stamps_s, *, max_gap_s=0.5, extrapolate_s=0.05) -> Trajectory:
    """2 m/s along x while turning at 0.4 rad/s."""
    stamps = np.array([START + round(s * SECOND) for s in stamps_s], dtype=np.int64)
    positions = np.array([[2.0 * s, 0.0, 1.0] for s in stamps_s]).reshape(-1, 3)
    rotations = np.array([about_z(0.4 * s) for s in stamps_s]).reshape(-1, 4)
    return Trajectory(stamps, positions, rotations, round(max_gap_s * SECOND), round(extrapolate_s * SECOND))


def at(trajectory, *seconds):
    return trajectory.at(np.array([START + round(s * SECOND) for s in seconds], dtype=np.int64))


@settings(deadline=None)
@given(quaternions, quaternions, fractions)
def test_slerp_agrees_with_the_textbook_formula(q0, q1, t):
    dot = float(np.dot(q0, q1))
    near = q1 if dot >= 0 else -q1
    theta = math.atan2(np.linalg.norm(near - q0), np.linalg.norm(near + q0)) * 2
    if theta < 1e-6:
        expected = q0 + t * (near - q0)
    else:
        expected = (math.sin((1 - t) * theta) * q0 + math.sin(t * theta) * near) / math.sin(theta)
    mixed = slerp(q0[None], q1[None], np.array([t]))[0]
    np.testing.assert_allclose(mixed, expected / np.linalg.norm(expected), atol=2e-15)
    assert np.linalg.norm(mixed) == pytest.approx(1.0, abs=1e-15)


@settings(deadline=None)
@given(quaternions, quaternions, fractions)
def test_slerp_takes_the_shorter_arc_at_constant_speed(q0, q1, t):
    def angle(a, b):
        w, *v = quaternion_multiply(a * [1, -1, -1, -1], b)
        return 2 * math.atan2(float(np.linalg.norm(v)), abs(w))

    mixed = slerp(q0[None], q1[None], np.array([t]))[0]
    assert angle(q0, mixed) == pytest.approx(t * angle(q0, q1), abs=1e-7)
    assert angle(mixed, q1) == pytest.approx((1 - t) * angle(q0, q1), abs=1e-7)


@settings(deadline=None)
@given(quaternions, quaternions, fractions)
def test_slerp_does_not_care_about_the_sign_of_a_quaternion(q0, q1, t):
    if abs(float(np.dot(q0, q1))) < 1e-9:
        return  # half a turn: both ways are equally short
    one = slerp(q0[None], q1[None], np.array([t]))
    other = slerp(q0[None], -q1[None], np.array([t]))
    np.testing.assert_array_equal(one, other)


@settings(deadline=None)
@given(st.lists(st.integers(1, 400_000_000), min_size=1, max_size=20), st.data())
def test_uniform_motion_is_met_at_every_time(steps_ns, data):
    stamps_s = np.concatenate([[0], np.cumsum(steps_ns)]) / SECOND
    trajectory = straight(stamps_s)
    t = data.draw(st.floats(0.0, float(stamps_s[-1])))
    positions, rotations, valid = at(trajectory, t)
    assert valid.all()
    np.testing.assert_allclose(positions[0], [2.0 * t, 0.0, 1.0], atol=1e-8)
    np.testing.assert_allclose(rotations[0], about_z(0.4 * t), atol=1e-8)


def test_recorded_poses_are_returned_bit_for_bit():
    trajectory = straight([0.0, 0.1, 0.35, 0.6])
    positions, rotations, valid = trajectory.at(trajectory.stamps_ns)
    assert valid.all()
    np.testing.assert_array_equal(positions, trajectory.positions_m)
    np.testing.assert_array_equal(rotations, trajectory.rotations)


def test_no_pose_inside_a_long_gap_but_at_its_ends():
    trajectory = straight([0.0, 0.5, 1.5, 1.6], max_gap_s=0.5)
    _, _, valid = at(trajectory, 0.25, 0.5, 0.500000001, 1.0, 1.499999999, 1.5, 1.55)
    assert valid.tolist() == [True, True, False, False, False, True, True]


def test_a_pose_between_two_gaps_holds_at_its_own_time():
    trajectory = straight([0.0, 5.0, 10.0], max_gap_s=0.5)
    positions, _, valid = at(trajectory, 4.9, 5.0, 5.1)
    assert valid.tolist() == [False, True, False]
    assert positions[1].tolist() == [10.0, 0.0, 1.0]
    assert np.isnan(positions[[0, 2]]).all()


def test_the_motion_goes_on_a_little_beyond_the_ends():
    trajectory = straight(np.arange(1.0, 2.0, 0.02), extrapolate_s=0.05)
    times = [0.949, 0.95, 0.97, 1.0, 1.98, 2.0, 2.03, 2.031]
    positions, rotations, valid = at(trajectory, *times)
    assert valid.tolist() == [False, True, True, True, True, True, True, False]
    for i in range(1, 7):
        np.testing.assert_allclose(positions[i], [2.0 * times[i], 0.0, 1.0], atol=1e-9)
        np.testing.assert_allclose(rotations[i], about_z(0.4 * times[i]), atol=1e-9)


@settings(deadline=None)
@given(quaternions, st.tuples(numbers, numbers, numbers), st.floats(0.0, 0.1))
def test_extrapolation_is_uniform_motion_about_any_axis(start, axis, beyond_s):
    """Truth: a rotation vector that grows with time."""

    def turned(t):
        vector = np.array(axis) * t
        angle = float(np.linalg.norm(vector))
        half = np.array([math.cos(angle / 2), *(vector * (math.sin(angle / 2) / angle if angle else 0.5))])
        return quaternion_multiply(start, half)

    times = np.array([0.0, 0.03, 0.11, 0.15])
    trajectory = Trajectory(
        START + np.round(times * SECOND).astype(np.int64),
        times[:, None] * [3.0, -1.0, 0.5],
        np.array([turned(t) for t in times]),
        SECOND // 2,
        SECOND // 10,
    )
    t = np.array([-beyond_s, 0.15 + beyond_s])
    positions, rotations, valid = at(trajectory, *t)
    assert valid.all()
    np.testing.assert_allclose(positions, t[:, None] * [3.0, -1.0, 0.5], atol=1e-8)
    for rotation, truth in zip(rotations, map(turned, t), strict=True):
        assert min(np.abs(rotation - truth).max(), np.abs(rotation + truth).max()) < 1e-7


def test_the_last_pose_holds_where_poses_pause_before_it():
    trajectory = straight([0.0, 0.1, 5.0], max_gap_s=0.5)
    positions, rotations, valid = at(trajectory, 5.04)
    assert valid.all()
    np.testing.assert_array_equal(positions[0], trajectory.positions_m[2])
    np.testing.assert_array_equal(rotations[0], trajectory.rotations[2])


def test_noise_of_poses_close_to_each_other_is_not_amplified():
    """The last two poses are 1 ms and 1 cm apart; 50 ms on, that velocity would be 50 cm off."""
    trajectory = straight([0.0, 0.02, 0.04, 0.06, 0.061])
    noisy = Trajectory(
        trajectory.stamps_ns,
        trajectory.positions_m + np.array([[0.0, 0.01 * (i == 4), 0.0] for i in range(5)]),
        trajectory.rotations,
        trajectory.max_gap_ns,
        trajectory.extrapolate_ns,
    )
    positions, _, _ = at(noisy, 0.061 + 0.05)
    assert abs(positions[0, 1]) <= 0.02 + 1e-9


def test_one_pose_that_moves_is_known_at_one_time():
    _, _, valid = at(straight([1.0], extrapolate_s=0.0), 0.999999999, 1.0, 1.000000001)
    assert valid.tolist() == [False, True, False]


def test_a_fixed_pose_holds_always():
    trajectory = Trajectory(
        np.zeros(1, np.int64), np.array([[1.0, 2, 3]]), np.array([[1.0, 0, 0, 0]]), 0, 0, fixed=True
    )
    positions, _, valid = at(trajectory, -5.0, 0.0, 1e6)
    assert valid.all()
    assert positions.tolist() == [[1.0, 2.0, 3.0]] * 3
    assert trajectory.pose_at(START) == SE3.create((1, 0, 0, 0), (1, 2, 3))


def test_no_poses_no_pose():
    trajectory = straight([])
    _, _, valid = at(trajectory, 0.0, 1.0)
    assert not valid.any()
    assert trajectory.pose_at(START) is None


def test_no_stamps_no_answers():
    positions, rotations, valid = at(straight([0.0, 0.1]))
    assert (positions.shape, rotations.shape, valid.shape) == ((0, 3), (0, 4), (0,))


@pytest.mark.parametrize("stamps_s", [[0.0, 0.0], [1.0, 0.5]])
def test_stamps_must_increase(stamps_s):
    with pytest.raises(ValueError, match="strictly increase"):
        straight(stamps_s)


def test_shapes_must_agree():
    with pytest.raises(ValueError, match=r"2 stamps need positions \(2, 3\)"):
        Trajectory(np.array([1, 2]), np.zeros((2, 2)), np.zeros((2, 4)), 0, 0)


@pytest.mark.parametrize("number", [0, 2])
def test_a_fixed_trajectory_has_exactly_one_pose(number):
    stamps = START + np.arange(number, dtype=np.int64)
    with pytest.raises(ValueError, match=f"a fixed trajectory has one pose, got {number}"):
        Trajectory(stamps, np.zeros((number, 3)), np.tile([1.0, 0, 0, 0], (number, 1)), 0, 0, fixed=True)


def test_a_gap_of_exactly_the_limit_is_interpolated_and_one_nanosecond_more_is_not():
    for gap_ns, valid in ((SECOND // 2, True), (SECOND // 2 + 1, False)):
        stamps = np.array([START, START + gap_ns], dtype=np.int64)
        moved = Trajectory(
            stamps, np.array([[0.0, 0, 0], [1, 0, 0]]), np.tile([1.0, 0, 0, 0], (2, 1)), SECOND // 2, 0
        )
        positions, _, known = moved.at(np.array([START + gap_ns // 2]))
        assert known.tolist() == [valid]
        assert not valid or positions[0, 0] == pytest.approx(0.5)


def test_extrapolation_ends_exactly_where_the_limit_says():
    trajectory = straight([0.0, 0.1, 0.2], extrapolate_s=0.05)
    ends = np.array([START - SECOND // 20, START + SECOND // 5 + SECOND // 20], dtype=np.int64)
    assert trajectory.at(ends)[2].tolist() == [True, True]
    assert trajectory.at(ends + np.array([-1, 1]))[2].tolist() == [False, False]
