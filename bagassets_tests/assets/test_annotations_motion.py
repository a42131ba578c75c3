"""Attributes by motion: what moves, what has stopped, what is parked, and what motion cannot say."""

from collections import Counter

import numpy as np
import pytest
from handmade import Drive, make_tables, true_boxes

from bagassets.assets.boxes.motion import MotionRule, motion_attributes
from bagassets.assets.boxes.table import BoxTable
from bagassets.assets.boxes.tracks import Track
from bagassets.formats.nuscenes.settings import AttributesByMotion
from bagassets.formats.nuscenes.tokens import attribute_token
from bagassets.store.store import Store

pytestmark = pytest.mark.once

S = 1_000_000_000
RULE = MotionRule(moving_mps=0.5, window_ns=S, parked_m=1.0, gap_ns=S)
CAR, WALKER = "vehicle.car", "human.pedestrian.adult"


def track(way, hz=10.0, seconds=10.0, noise_m=0.0):
    """A track along x; `way` gives metres at seconds."""
    times = np.arange(0, seconds, 1 / hz)
    centers = np.zeros((len(times), 3))
    centers[:, 0] = [way(t) for t in times]
    centers += np.random.default_rng(0).normal(0, noise_m, centers.shape) if noise_m else 0.0
    stamps = np.round(times * S).astype(np.int64)
    rotations = np.tile([1.0, 0.0, 0.0, 0.0], (len(times), 1))
    return Track("/boxes", "1", stamps, np.arange(len(times)), centers, rotations)


def attributes(the_track, *seconds, category=CAR, rule=RULE):
    times = np.array([round(t * S) for t in seconds], dtype=np.int64)
    return motion_attributes(category, the_track, times, rule)


def stop_and_go(t):
    """5 m/s for 3 s, at rest for 4 s, on again."""
    return 5.0 * min(t, 3.0) + 5.0 * max(t - 7.0, 0.0)


class TestVehicles:
    def test_one_that_drives_is_moving_from_its_first_to_its_last_observation(self):
        assert attributes(track(lambda t: 3.0 * t), 0.0, 5.0, 9.9) == ["vehicle.moving"] * 3

    def test_one_that_never_moved_is_parked(self):
        assert attributes(track(lambda _: 4.0), 0.0, 5.0, 9.9) == ["vehicle.parked"] * 3

    def test_one_that_rests_and_moved_before_or_will_move_has_stopped(self):
        found = attributes(track(stop_and_go), 1.0, 4.0, 6.0, 9.0)
        assert found == ["vehicle.moving", "vehicle.stopped", "vehicle.stopped", "vehicle.moving"]

    def test_labels_that_jitter_by_decimetres_are_parked_all_the_same(self):
        assert set(attributes(track(lambda _: 4.0, noise_m=0.08), *np.arange(0, 9, 0.5))) == {
            "vehicle.parked"
        }

    def test_one_that_creeps_away_was_not_parked(self):
        assert set(attributes(track(lambda t: 0.3 * t), 0.5, 5.0)) == {"vehicle.stopped"}
        assert set(attributes(track(lambda t: 0.05 * t), 0.5, 5.0)) == {"vehicle.parked"}

    @pytest.mark.parametrize(("speed", "name"), [(0.5, "vehicle.moving"), (0.498, "vehicle.stopped")])
    def test_the_threshold_itself_is_moving(self, speed, name):
        assert attributes(track(lambda t: speed * t, hz=8.0), 5.0) == [name]

    def test_height_does_not_count(self):
        up = track(lambda _: 4.0)
        up.centers_m[:, 2] = np.arange(len(up.centers_m))
        assert attributes(up, 5.0) == ["vehicle.parked"]

    @pytest.mark.parametrize("category", ["vehicle.truck", "vehicle.bus.rigid", "vehicle.emergency.police"])
    def test_all_kinds_of_vehicles(self, category):
        assert attributes(track(lambda t: t), 5.0, category=category) == ["vehicle.moving"]


class TestPersons:
    def test_one_who_walks_and_waits(self):
        found = attributes(track(stop_and_go), 1.0, 5.0, category=WALKER)
        assert found == ["pedestrian.moving", "pedestrian.standing"]

    def test_one_who_never_moves_may_sit(self):
        assert attributes(track(lambda _: 4.0), 1.0, 5.0, category=WALKER) == ["", ""]

    def test_kinds_that_are_no_pedestrians_of_the_devkit_get_none(self):
        assert attributes(track(stop_and_go), 1.0, category="human.pedestrian.wheelchair") == [""]


@pytest.mark.parametrize(
    "category", ["vehicle.bicycle", "vehicle.motorcycle", "movable_object.barrier", "car"]
)
def test_riders_and_other_classes_are_not_guessed(category):
    assert attributes(track(lambda t: 3.0 * t), 5.0, category=category) == [""]


class TestShortTracks:
    def test_one_observation_says_nothing(self):
        assert attributes(track(lambda t: t, seconds=0.1), 0.0) == [""]

    def test_less_than_half_the_window_says_nothing(self):
        assert attributes(track(lambda t: 3 * t, seconds=0.5), 0.2) == [""]
        assert attributes(track(lambda t: 3 * t, seconds=0.6), 0.2) == ["vehicle.moving"]

    def test_no_speed_is_measured_across_a_gap(self):
        whole = track(stop_and_go)
        rows = np.flatnonzero((whole.stamps_ns <= 2 * S) | (whole.stamps_ns == 5 * S))
        paused = Track(
            "/boxes", "1", whole.stamps_ns[rows], rows, whole.centers_m[rows], whole.rotations[rows]
        )
        assert attributes(paused, 1.0, 5.0) == ["vehicle.moving", ""]

    def test_but_what_never_moved_is_parked_after_a_gap_too(self):
        whole = track(lambda _: 4.0)
        rows = np.flatnonzero((whole.stamps_ns <= 2 * S) | (whole.stamps_ns == 5 * S))
        paused = Track(
            "/boxes", "1", whole.stamps_ns[rows], rows, whole.centers_m[rows], whole.rotations[rows]
        )
        assert attributes(paused, 1.0, 5.0) == ["vehicle.parked"] * 2

    def test_keyframes_beyond_the_ends_have_the_speed_at_the_end(self):
        assert attributes(track(stop_and_go), -0.1, 10.0) == ["vehicle.moving"] * 2


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    return Store(tmp_path_factory.mktemp("store"))


class TestTables:
    """Of the drive made by hand: a parked car, a moving car, and a person who walks."""

    @staticmethod
    def bare():
        boxes = true_boxes(Drive())
        names = [["pedestrian.sitting_lying_down"] if track == "walker" else [] for track in boxes.tracks]
        return BoxTable(
            boxes.stamps_ns, boxes.tracks, boxes.categories, names, boxes.centers_m, boxes.rotations, boxes.sizes_m,
            boxes.scores, boxes.sources,
        )  # fmt: skip

    @staticmethod
    def counted(made):
        boxes = made.facts["counts"]["boxes"]
        kinds = {name: boxes[f"attributes_{name}"] for name in ("given", "by_motion", "undetermined", "none")}
        assert sum(kinds.values()) == boxes["annotations"]
        return kinds

    def test_what_the_source_gives_wins(self, store):
        made = make_tables(store, table=self.bare())
        found = Counter(row["attribute_tokens"][0] for row in made.table("sample_annotation"))
        names = ("vehicle.parked", "vehicle.moving", "pedestrian.sitting_lying_down")
        assert found == {attribute_token(name): 8 for name in names}
        assert made.facts["attributes"] == sorted(names)
        assert self.counted(made) == {"given": 8, "by_motion": 16, "undetermined": 0, "none": 0}

    def test_the_recipe_can_turn_it_off(self, store):
        made = make_tables(store, table=self.bare(), attributes=AttributesByMotion(enabled=False))
        assert made.facts["attributes"] == ["pedestrian.sitting_lying_down"]
        assert self.counted(made) == {"given": 8, "by_motion": 0, "undetermined": 16, "none": 0}

    def test_the_recipe_sets_the_thresholds(self, store):
        fast = make_tables(store, table=self.bare(), attributes=AttributesByMotion(moving_mps=4.5))
        assert fast.facts["attributes"] == [
            "pedestrian.sitting_lying_down",
            "vehicle.parked",
            "vehicle.stopped",
        ]

    def test_thresholds_key_the_step_only_where_they_are_used(self, store):
        params = [
            make_tables(store, attributes=AttributesByMotion(**fields)).use.params
            for fields in ({}, {"moving_mps": 1.0}, {"enabled": False}, {"enabled": False, "moving_mps": 1.0})
        ]
        assert params[0] != params[1] != params[2] == params[3]

    def test_boxes_without_identity_get_none(self, store):
        boxes = self.bare()
        single = BoxTable(
            boxes.stamps_ns, [""] * len(boxes), boxes.categories, [[]] * len(boxes), boxes.centers_m, boxes.rotations,
            boxes.sizes_m, boxes.scores, boxes.sources,
        )  # fmt: skip
        assert self.counted(make_tables(store, table=single)) == {
            "given": 0,
            "by_motion": 0,
            "undetermined": 24,
            "none": 0,
        }

    def test_a_class_that_nuscenes_does_not_know_has_none(self, store):
        boxes = self.bare()
        other = BoxTable(
            boxes.stamps_ns, boxes.tracks, ["dog"] * len(boxes), [[]] * len(boxes), boxes.centers_m, boxes.rotations,
            boxes.sizes_m, boxes.scores, boxes.sources,
        )  # fmt: skip
        assert self.counted(make_tables(store, table=other))["none"] == 24
