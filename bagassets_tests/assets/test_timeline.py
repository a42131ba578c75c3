"""Scenes and keyframes: exact on regular clocks, and well behaved on any."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bagassets.assets.timeline.keyframes import (
    choose_keyframes,
    match_readings,
    nearest,
    owning_keyframe,
    partner_readings,
)
from bagassets.formats.nuscenes.scene_plan import cut_scenes, stretches

pytestmark = pytest.mark.once

S = 1_000_000_000
START = 1_700_000_000 * S


def stamps(*seconds):
    return START + (np.array(seconds, dtype=np.float64) * 1e9).round().astype(np.int64)


def regular(hz, seconds, phase_s=0.0):
    return stamps(*(phase_s + np.arange(round(hz * seconds)) / hz))


def chosen_of(readings, *grid, **options):
    """The readings that became keyframes, without the targets that have none."""
    found = choose_keyframes(readings, *grid, **options)
    return found[found >= 0]


def keyframe_seconds(readings, hz=2.0, *others, tolerance_s=0.1):
    partners = [partner_readings(readings, other, round(tolerance_s * S)) for other in others]
    chosen = chosen_of(
        readings, START, int(readings[-1]), round(S / hz), partners=np.stack(partners) if others else None
    )
    return ((readings[chosen] - START) / S).round(3).tolist()


sorted_stamps = st.lists(st.integers(0, 60 * S), max_size=200, unique=True).map(
    lambda values: START + np.array(sorted(values), dtype=np.int64)
)


class TestScenes:
    def test_twenty_seconds_of_a_ten_hertz_lidar_are_one_scene(self):
        scenes, remainder_ns = cut_scenes(START, START + round(19.9 * S), 20 * S, S, S // 2)
        assert len(scenes) == 1
        assert remainder_ns == 0

    def test_the_bounds_of_scenes_and_their_windows(self):
        """Windows open and close half a keyframe period before the grid; the last one closes after the last reading."""
        first, last = cut_scenes(START, START + 27 * S, 20 * S, 7 * S, S // 2)[0]
        assert (first.start_ns, first.end_ns) == (START, START + 20 * S - 1)
        assert (first.window_start_ns, first.window_end_ns) == (START - S // 4, START + 20 * S - S // 4)
        assert (last.start_ns, last.end_ns) == (START + 20 * S, START + 27 * S)
        assert (last.window_start_ns, last.window_end_ns) == (
            START + 20 * S - S // 4,
            START + 27 * S + S // 4 + 1,
        )

    def test_a_remainder_one_nanosecond_below_the_minimum_is_none(self):
        scenes, remainder_ns = cut_scenes(START, START + 27 * S - 1, 20 * S, 7 * S, S // 2)
        assert (len(scenes), remainder_ns) == (1, 7 * S - 1)

    def test_no_remainder_makes_no_scene_of_length_zero(self):
        scenes, remainder_ns = cut_scenes(START, START + 40 * S, 20 * S, 0, S // 2)
        assert (len(scenes), remainder_ns) == (2, 0)

    def test_a_long_remainder_is_a_shorter_scene(self):
        scenes, remainder_ns = cut_scenes(START, START + 47 * S, 20 * S, S, S // 2)
        assert [round(scene.duration_s, 3) for scene in scenes] == [20.0, 20.0, 7.0]
        assert remainder_ns == 0

    def test_a_short_remainder_is_no_scene_and_is_reported(self):
        scenes, remainder_ns = cut_scenes(START, START + 40 * S + S // 4, 20 * S, S, S // 2)
        assert len(scenes) == 2
        assert remainder_ns == S // 4

    def test_a_recording_shorter_than_the_minimum_has_no_scene(self):
        scenes, remainder_ns = cut_scenes(START, START + S // 2, 20 * S, S, S // 2)
        assert scenes == []
        assert remainder_ns == S // 2

    def test_a_single_reading_makes_a_scene_only_if_the_recipe_allows_length_zero(self):
        assert cut_scenes(START, START, 20 * S, 1, S // 2)[0] == []
        (scene,) = cut_scenes(START, START, 20 * S, 0, S // 2)[0]
        assert scene.window_start_ns <= START < scene.window_end_ns
        assert len(chosen_of(stamps(0), scene.start_ns, scene.end_ns, S // 2)) == 1

    @given(
        span=st.integers(0, 200 * S),
        length=st.integers(S, 60 * S),
        minimum=st.integers(0, 60 * S),
        period=st.integers(S // 50, 2 * S),
    )
    def test_windows_are_disjoint_and_time_is_accounted_for(self, span, length, minimum, period):
        scenes, remainder_ns = cut_scenes(START, START + span, length, minimum, period)
        for before, after in pairwise(scenes):
            assert before.window_end_ns == after.window_start_ns
            assert before.end_ns + 1 == after.start_ns
        covered = sum(scene.end_ns - scene.start_ns + 1 for scene in scenes)
        assert abs(covered + remainder_ns - span) <= 1
        assert all(scene.end_ns - scene.start_ns + 1 >= min(minimum, length) for scene in scenes)


class TestStretches:
    """A pause that is longer than a scene ends one, and the next begins with the next reading."""

    @pytest.mark.parametrize("jump_s", [20.11, 3600.0, 30 * 86_400.0, 55 * 365 * 86_400.0])
    def test_two_spans_however_far_apart(self, jump_s):
        readings = np.concatenate([regular(10, 2.5), regular(10, 2.5, 2.4 + jump_s)])
        first, second = stretches(readings, 20 * S, S // 2)
        assert first == (START, START + 24 * S // 10)
        assert second == (int(readings[25]), int(readings[-1]))

    @pytest.mark.parametrize("gap_s", [1.0, 5.0, 19.9])
    def test_a_dropout_stays_inside(self, gap_s):
        readings = np.concatenate([regular(10, 30), regular(10, 30, 29.9 + gap_s)])
        assert stretches(readings, 20 * S, S // 2) == [(START, int(readings[-1]))]

    def test_readings_that_are_rarer_than_scenes_are_no_pauses(self):
        readings = regular(1 / 30, 900)
        assert stretches(readings, 20 * S, S // 2) == [(START, int(readings[-1]))]

    def test_however_long_scenes_are_an_hour_without_readings_ends_one(self):
        readings = np.concatenate([regular(10, 5), regular(10, 5, 3700.0)])
        assert len(stretches(readings, 10**9 * S, S // 2)) == 2

    def test_one_reading(self):
        assert stretches(stamps(0.0), 20 * S, S // 2) == [(START, START)]


class TestKeyframes:
    def test_ten_hertz_reference_gives_two_hertz_keyframes(self):
        assert keyframe_seconds(regular(10, 3)) == [0.0, 0.5, 1.0, 1.5, 2.0, 2.5]

    def test_their_number_follows_the_length_of_the_scene(self):
        for seconds in (1, 7, 20, 33):
            assert len(keyframe_seconds(regular(10, seconds))) == 2 * seconds

    def test_a_short_gap_costs_nothing(self):
        readings = regular(10, 20)
        gap = (readings > START + 7.05 * S) & (readings < START + 7.25 * S)
        seconds = keyframe_seconds(readings[~gap])
        assert len(seconds) == 40
        assert max(np.diff(seconds)) <= 0.6

    def test_a_long_gap_costs_the_keyframes_inside_it_and_no_others(self):
        readings = regular(10, 20)
        gap = (readings > START + 7.25 * S) & (readings < START + 9.75 * S)
        seconds = keyframe_seconds(readings[~gap])
        assert seconds == [t for t in (np.arange(40) / 2).tolist() if not 7.25 < t < 9.75]

    def test_a_reference_slower_than_the_grid_gives_all_its_readings(self):
        assert keyframe_seconds(regular(1, 5)) == [0.0, 1.0, 2.0, 3.0, 4.0]
        assert len(keyframe_seconds(regular(1.5, 7))) == 10

    def test_a_rate_that_is_no_multiple_keeps_the_mean_rate(self):
        assert len(keyframe_seconds(regular(3, 20))) == pytest.approx(40, abs=1)
        assert len(keyframe_seconds(regular(7.3, 20))) == pytest.approx(40, abs=1)

    def test_no_readings_no_keyframes(self):
        assert len(chosen_of(stamps(), START, START + 5 * S, S // 2)) == 0

    @given(readings=sorted_stamps, hz=st.sampled_from([0.5, 1.0, 2.0, 5.0, 10.0]), end=st.integers(0, 60 * S))
    def test_for_any_clock(self, readings, hz, end):
        period = round(S / hz)
        chosen = chosen_of(readings, START, START + end, period)
        picked = readings[chosen]
        assert (np.diff(chosen) > 0).all()
        assert (np.diff(picked) >= period // 2).all()
        # Each lies in the cell of a target of its own.
        cells = (picked - START + period // 2) // period
        assert (np.diff(cells) > 0).all()
        # A target whose cell has a reading well after the keyframe before is never left out.
        for number in range(end // period + 1):
            target = START + number * period
            inside = readings[(readings >= target - period // 2) & (readings < target + period // 2)]
            before = picked[picked < target - period // 2]
            free = inside if not len(before) else inside[inside >= before[-1] + period // 2]
            if len(free):
                assert ((picked >= target - period // 2) & (picked < target + period // 2)).any()

    @given(jitter=st.lists(st.integers(-20_000_000, 20_000_000), min_size=200, max_size=200))
    def test_jitter_of_the_clock_changes_no_count(self, jitter):
        readings = np.sort(regular(10, 20) + np.array(jitter))
        assert len(keyframe_seconds(readings)) == 40


class TestCompleteKeyframes:
    """With partners a keyframe lies where every channel has a reading."""

    def test_a_gap_of_one_channel_moves_a_keyframe_to_the_nearest_complete_reading(self):
        lidar, camera = regular(10, 2), regular(10, 2, 0.01)
        gap = (camera > START + 0.85 * S) & (camera < START + 1.15 * S)
        assert keyframe_seconds(lidar, 2.0, camera[~gap], tolerance_s=0.05) == [0.0, 0.5, 0.8, 1.5]

    def test_a_channel_that_stops_costs_what_follows(self):
        assert keyframe_seconds(regular(10, 4), 2.0, regular(10, 2)) == [0.0, 0.5, 1.0, 1.5, 2.0]

    def test_every_channel_counts(self):
        lidar = regular(10, 3)
        early, late = regular(10, 2), regular(10, 2, 1.0)
        assert keyframe_seconds(lidar, 2.0, early, late, tolerance_s=0.04) == [1.0, 1.5, 1.9]

    def test_two_keyframes_never_share_a_reading(self):
        assert keyframe_seconds(regular(20, 2), 2.0, stamps(0.25, 1.25), tolerance_s=0.24) == [0.05, 1.05]

    def test_nor_one_reading_of_one_channel_of_several(self):
        rare, dense = stamps(0.25, 1.25), regular(20, 2)
        assert keyframe_seconds(regular(20, 2), 2.0, rare, dense, tolerance_s=0.24) == [0.05, 1.05]

    def test_a_slow_channel_sets_the_pace(self):
        seconds = keyframe_seconds(regular(10, 20), 2.0, regular(1, 20, 0.3))
        assert len(seconds) == 20

    def test_usual_rates_cost_no_keyframe(self):
        others = [regular(hz, 20, 0.017) for hz in (13, 12, 20, 50, 5)]
        assert len(keyframe_seconds(regular(10, 20), 2.0, *others)) == 40

    @given(
        readings=sorted_stamps,
        others=st.lists(sorted_stamps, min_size=1, max_size=3),
        hz=st.sampled_from([0.5, 1.0, 2.0, 5.0, 10.0]),
        share=st.floats(0.01, 0.49),
    )
    def test_for_any_clocks_each_is_complete_and_none_is_left_out_that_could_be(
        self, readings, others, hz, share
    ):
        period = round(S / hz)
        tolerance, end = int(share * period), START + 60 * S
        partners = np.stack([partner_readings(readings, other, tolerance) for other in others])
        found = choose_keyframes(readings, START, end, period, partners)
        picked = readings[found[found >= 0]]
        assert (np.diff(found[found >= 0]) > 0).all()
        assert (np.diff(picked) >= period // 2).all()
        for other in others:
            assert (match_readings(picked, other, tolerance) >= 0).all()
        complete = (partners >= 0).all(axis=0)
        for number, index in enumerate(found.tolist()):
            if index >= 0:
                continue
            target = START + number * period
            inside = np.flatnonzero(
                complete & (readings >= target - period // 2) & (readings < target + period // 2)
            )
            before = found[:number][found[:number] >= 0]
            for candidate in inside.tolist():
                assert len(before)
                assert (
                    readings[candidate] < readings[before[-1]] + period // 2
                    or (partners[:, candidate] == partners[:, before[-1]]).any()
                )


class TestMatching:
    def test_each_keyframe_takes_the_nearest(self):
        keyframes = stamps(0.0, 0.5, 1.0)
        camera = stamps(0.06, 0.13, 0.44, 0.52, 0.91, 1.2)
        assert match_readings(keyframes, camera, S // 10).tolist() == [0, 3, 4]

    def test_beyond_the_tolerance_there_is_none(self):
        assert match_readings(stamps(0.0, 0.5), stamps(0.2, 0.61), S // 10).tolist() == [-1, -1]
        assert match_readings(stamps(0.0, 0.5), stamps(0.2, 0.6), S // 10).tolist() == [-1, 1]

    def test_a_reading_between_two_keyframes_goes_to_the_nearer_one(self):
        assert match_readings(stamps(0.0, 0.5), stamps(0.3), S).tolist() == [-1, 0]

    def test_a_reading_that_is_nearest_to_one_keyframe_only_is_its_own(self):
        assert match_readings(stamps(0.0, 0.3), stamps(0.16, 0.35), S // 5).tolist() == [0, 1]

    def test_empty(self):
        assert match_readings(stamps(0.0), stamps(), S).tolist() == [-1]
        assert match_readings(stamps(), stamps(0.0), S).tolist() == []

    @given(keyframes=sorted_stamps, readings=sorted_stamps, tolerance=st.integers(1, 2 * S))
    def test_for_any_clocks(self, keyframes, readings, tolerance):
        matched = match_readings(keyframes, readings, tolerance)
        used = matched[matched >= 0]
        assert len(set(used.tolist())) == len(used)
        assert (np.diff(used) > 0).all()
        for keyframe, index in zip(keyframes, matched, strict=True):
            away = np.abs(readings - keyframe)
            if index >= 0:
                assert away[index] == away.min()
                assert away[index] <= tolerance
            elif len(readings) and away.min() <= tolerance:
                # Refused only because another keyframe has that reading, and is at least as near to it.
                candidate = np.flatnonzero(away == away.min())[0]
                (other,) = keyframes[matched == candidate]
                assert abs(other - readings[candidate]) <= away.min()

    @given(keyframes=sorted_stamps.filter(len), readings=sorted_stamps)
    def test_readings_belong_to_the_sample_that_follows_closest(self, keyframes, readings):
        owner = owning_keyframe(keyframes, readings)
        for reading, index in zip(readings, owner, strict=True):
            following = np.flatnonzero(keyframes >= reading)
            assert index == (following[0] if len(following) else len(keyframes) - 1)

    @given(stamps_ns=sorted_stamps.filter(len), times=sorted_stamps)
    def test_nearest(self, stamps_ns, times):
        for time, index in zip(times, nearest(stamps_ns, times), strict=True):
            assert index == np.argmin(np.abs(stamps_ns - time))
