"""Which value a frame gets: each rule against its definition, value by value."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bagassets.formats.lerobot.grid import grid_ns, pick, values_at

stamps = st.lists(st.integers(0, 200), min_size=1, max_size=20, unique=True).map(sorted)
times = st.lists(st.integers(0, 200), min_size=1, max_size=20).map(sorted)


class TestGrid:
    @given(st.integers(0, 10**18), st.integers(1, 240), st.integers(1, 5000))
    def test_frame_i_stands_at_i_over_fps_to_half_a_nanosecond(self, start_ns, fps, number):
        found = grid_ns(start_ns, start_ns + number * 10**9 // fps + 1, fps)
        assert len(found) == number + 1
        exact = [(number * 10**9, fps) for number in range(len(found))]
        assert all(
            abs((int(t) - start_ns) * fps - over) * 2 <= under
            for t, (over, under) in zip(found, exact, strict=True)
        )

    def test_it_ends_with_the_episode(self):
        assert grid_ns(0, 999_999_999, 10).tolist()[-1] == 900_000_000
        assert grid_ns(0, 1_000_000_000, 10).tolist()[-1] == 1_000_000_000
        assert len(grid_ns(5, 4, 10)) == 0


class TestRules:
    @given(stamps, times, st.integers(1, 60))
    def test_latest_is_the_last_value_before_within_tolerance(self, there, asked, tolerance):
        found = pick(np.array(there), np.array(asked), "latest", tolerance)
        for index, time in enumerate(asked):
            before = [n for n, stamp in enumerate(there) if stamp <= time]
            near = bool(before) and time - there[before[-1]] <= tolerance
            assert found.has_value[index] == near
            assert not near or found.before[index] == before[-1]

    @given(stamps, times, st.integers(1, 60))
    def test_nearest_is_nearest(self, there, asked, tolerance):
        found = pick(np.array(there), np.array(asked), "nearest", tolerance)
        for index, time in enumerate(asked):
            distance = min(abs(stamp - time) for stamp in there)
            assert found.has_value[index] == (distance <= tolerance)
            assert distance > tolerance or abs(there[found.before[index]] - time) == distance

    @given(stamps, times)
    def test_hold_is_the_last_value_however_old(self, there, asked):
        found = pick(np.array(there), np.array(asked), "hold", 1)
        for index, time in enumerate(asked):
            before = [n for n, stamp in enumerate(there) if stamp <= time]
            assert found.has_value[index] == bool(before)
            assert not before or found.before[index] == before[-1]

    @given(stamps, times, st.integers(1, 60))
    def test_linear_gives_a_straight_line_back_and_needs_both_neighbours(self, there, asked, tolerance):
        found = pick(np.array(there), np.array(asked), "linear", tolerance)
        line = np.array(there, float)[:, None] * 3 - 7
        for index, time in enumerate(asked):
            before = [stamp for stamp in there if stamp <= time]
            after = [stamp for stamp in there if stamp >= time]
            near = bool(before and after) and max(time - before[-1], after[0] - time) <= tolerance
            assert found.has_value[index] == near
            if near:
                value = values_at(line, found)[index, 0]
                assert value == pytest.approx(time * 3 - 7)

    def test_what_is_held_is_the_value_before_the_gap(self):
        found = pick(np.array([0, 10, 100]), np.array([5, 15, 90, 105]), "latest", 8).held()
        assert found.before.tolist() == [0, 1, 1, 2]
        assert found.has_value.all()
        assert found.repeated == 1

    @pytest.mark.parametrize("at", ["nearest", "linear"])
    def test_what_is_held_is_never_the_value_after_the_gap(self, at):
        """A frame would show what had not happened yet."""
        found = pick(np.array([0, 100]), np.array([3, 40, 60, 97]), at, 8).held()
        assert found.has_value.all()
        line = values_at(np.array([[0.0], [100.0]]), found)[:, 0]
        assert line.tolist() == ([0, 0, 0, 100] if at == "nearest" else [0, 0, 0, 0])
