"""Tracks at keyframes: interpolated between observations, moved on near them, absent elsewhere."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bagassets.assets.boxes.tracks import Track

pytestmark = pytest.mark.once

S = 1_000_000_000


def track(*seconds, speed=3.0):
    """Drive along x at `speed`, turning by 0.2 rad/s."""
    stamps = np.array([round(t * S) for t in seconds], dtype=np.int64)
    t = stamps / S
    rotations = np.stack([np.cos(0.1 * t), 0 * t, 0 * t, np.sin(0.1 * t)], axis=1)
    centers = np.stack([speed * t, 0 * t, 0 * t], axis=1)
    return Track("/boxes", "1", stamps, np.arange(len(stamps)), centers, rotations)


def at(the_track, *seconds, gap_s=1.0, tolerance_s=0.1):
    times = np.array([round(t * S) for t in seconds], dtype=np.int64)
    return the_track.at(times, round(gap_s * S), round(tolerance_s * S))


def test_between_observations_the_box_moves_evenly():
    found = at(track(0.0, 0.8), 0.2, 0.6)
    np.testing.assert_allclose(found.centers_m[:, 0], [0.6, 1.8])
    np.testing.assert_allclose(found.rotations[:, 3], np.sin([0.02, 0.06]))
    assert found.observations.tolist() == [0, 1]
    assert found.held == 0


def test_at_an_observation_it_is_that_observation():
    found = at(track(0.0, 0.7, 5.0), 0.7, 5.0)
    np.testing.assert_array_equal(found.centers_m[:, 0], [3.0 * 0.7, 15.0])


def test_before_the_first_and_after_the_last_the_box_moves_on_for_the_tolerance():
    found = at(track(1.0, 2.0), 0.85, 0.95, 2.05, 2.15)
    assert found.at.tolist() == [1, 2]
    np.testing.assert_allclose(found.centers_m[:, 0], [2.85, 6.15])
    np.testing.assert_allclose(found.rotations[:, 3], np.sin([0.095, 0.205]), atol=1e-12)
    assert found.held == 2


def test_in_a_long_gap_it_moves_on_near_the_observations_and_is_absent_between():
    found = at(track(0.0, 0.4, 4.0, 4.4), 0.45, 2.0, 3.95)
    assert found.at.tolist() == [0, 2]
    np.testing.assert_allclose(found.centers_m[:, 0], [1.35, 11.85])
    assert found.held == 2


def test_lone_observations_hold():
    found = at(track(0.0, 4.0), 0.05, 2.0, 3.95)
    assert found.at.tolist() == [0, 2]
    np.testing.assert_allclose(found.centers_m[:, 0], [0.0, 12.0])


def test_one_observation_is_a_track():
    found = at(track(1.0), 0.5, 1.05)
    assert found.at.tolist() == [1]


@given(
    observed=st.lists(st.integers(0, 100), min_size=1, max_size=20, unique=True).map(sorted),
    asked=st.lists(st.integers(-10, 110), max_size=20, unique=True).map(sorted),
)
def test_boxes_never_leave_the_path_by_more_than_the_tolerance(observed, asked):
    found = at(track(*(t / 10 for t in observed)), *(t / 10 for t in asked), gap_s=0.5, tolerance_s=0.2)
    for index, center in zip(found.at, found.centers_m, strict=True):
        assert center[0] == pytest.approx(3.0 * asked[index] / 10, abs=3.0 * 0.2 + 1e-9)
    for index, time in enumerate(asked):
        near = min(abs(time - t) for t in observed) <= 2
        gaps = [b - a for a, b in pairwise(observed) if a <= time <= b]
        assert (index in found.at) == (near or any(gap <= 5 for gap in gaps) or time in observed)
