"""The split by recording: a function of the set of recordings that leaves none empty and moves few."""

import json
import random

import pytest
from handmade import Drive, make_tables
from hypothesis import given
from hypothesis import strategies as st

from bagassets.engine.splits import deal, moves, shares_of
from bagassets.formats.assembly import assemble
from bagassets.formats.dataset_lock import read_lock
from bagassets.formats.format import Part
from bagassets.formats.nuscenes.format import NUSCENES
from bagassets.formats.nuscenes.schema import DEVKIT_SPLITS, devkit_split_name
from bagassets.formats.nuscenes.settings import NuScenes
from bagassets.recipe.model_splits import Splits
from bagassets.store.store import Store

pytestmark = pytest.mark.once

KEYS = [f"drive_{number}" for number in range(2000)]
SPLITS = Splits(shares={"train": 0.7, "val": 0.2, "test": 0.1})


DEFAULT = Splits()


def counts(dealt):
    found = list(dealt.values())
    return {name: found.count(name) for name in sorted(set(found))}


some_keys = st.sets(st.text("abcdef_0123456789", min_size=1, max_size=8), max_size=40)
some_splits = st.sampled_from(
    [
        DEFAULT,
        SPLITS,
        Splits(shares={"a": 0.5, "b": 0.5}, seed=1),
        Splits(shares={"a": 0.96, "b": 0.03, "c": 0.01}),
        Splits(shares={"a": 0.25, "b": 0.25, "c": 0.25, "d": 0.25}, seed=7),
        Splits(shares={"all": 1.0, "none": 0.0}),
    ]
)


class TestDeal:
    def test_shares_are_met_approximately(self):
        found = counts(deal(KEYS, SPLITS))
        for name, share in SPLITS.shares.items():
            assert found[name] / len(KEYS) == pytest.approx(share, abs=0.03)

    @pytest.mark.parametrize(
        ("number", "expected"),
        [(0, {}), (1, (1, 0)), (2, (1, 1)), (3, (2, 1)), (4, (3, 1)), (5, (4, 1)), (6, (5, 1)), (10, (8, 2))],
    )  # fmt: skip
    def test_small_sets_are_split_as_asked(self, number, expected):
        wanted = dict(zip(("train", "val"), expected, strict=True)) if expected else {}
        wanted = {name: count for name, count in wanted.items() if count}
        for seed in range(50):
            assert counts(deal(KEYS[:number], Splits(seed=seed))) == wanted

    @given(some_keys, some_splits)
    def test_no_split_that_is_asked_for_is_empty_while_there_are_as_many_recordings(self, keys, splits):
        asked = {name for name, share in splits.shares.items() if share > 0}
        dealt = deal(keys, splits)
        assert dealt.keys() == keys
        assert set(dealt.values()) <= asked
        if len(keys) >= len(asked):
            assert set(dealt.values()) == asked

    @given(some_keys, some_splits)
    def test_no_share_is_off_by_more_than_two_boundaries_and_a_recording(self, keys, splits):
        found = counts(deal(keys, splits))
        for name, share in splits.shares.items():
            slack = max(1 + 0.1 * len(keys), len(splits.shares))
            assert abs(found.get(name, 0) - share * len(keys)) <= slack

    def test_two_splits_are_off_by_half_a_recording_and_five_percent_at_most(self):
        for seed in range(20):
            for number in (7, 20, 50, 100, 300):
                found = counts(deal(KEYS[:number], Splits(seed=seed)))
                assert abs(found["train"] - 0.8 * number) <= 0.5 + 0.05 * number
                halves = counts(deal(KEYS[:number], Splits(shares={"a": 0.5, "b": 0.5}, seed=seed)))
                assert abs(halves["a"] - 0.5 * number) <= 0.5 + 0.05 * number

    @given(some_keys, some_splits, st.randoms())
    def test_neither_order_nor_repetition_matters(self, keys, splits, rng):
        shuffled = [*keys, *keys]
        rng.shuffle(shuffled)
        assert deal(shuffled, splits) == deal(sorted(keys), splits)

    @given(some_keys.filter(lambda keys: len(keys) > 4), some_splits, st.data())
    def test_one_recording_less_moves_at_most_one_for_each_boundary(self, keys, splits, data):
        gone = data.draw(st.sampled_from(sorted(keys)))
        asked = sum(share > 0 for share in splits.shares.values())
        assert len(moves(deal(keys, splits), deal(keys - {gone}, splits))) <= asked - 1

    def test_few_move_while_a_set_grows_and_none_once_it_is_large(self):
        moved = {}
        order = random.Random(3).sample(KEYS, 1500)
        before = deal(order[:2], DEFAULT)
        for number in (*range(3, 850), *range(850, len(order) + 1, 50)):
            after = deal(order[:number], DEFAULT)
            moved[number] = len(moves(before, after))
            before = after
        assert sum(moved.values()) < 60
        assert sum(count for number, count in moved.items() if number > 800) == 0

    def test_of_a_large_set_it_is_fixed_for_ever(self):
        found = [deal(KEYS, SPLITS)[key] for key in KEYS[2:8]]
        assert found == ["train", "test", "train", "train", "train", "val"]
        reordered = Splits(shares=dict(reversed(SPLITS.shares.items())))
        assert deal(KEYS, reordered) == deal(KEYS, SPLITS)

    def test_growing_a_share_only_moves_recordings_into_it(self):
        before = deal(KEYS, Splits(shares={"a": 0.5, "b": 0.5}))
        after = deal(KEYS, Splits(shares={"a": 0.6, "b": 0.4}))
        assert all(after[key] == "a" for key in KEYS if before[key] == "a")
        assert 0.05 < sum(before[key] != after[key] for key in KEYS) / len(KEYS) < 0.15

    def test_another_seed_deals_anew(self):
        assert deal(KEYS, SPLITS) != deal(KEYS, SPLITS.model_copy(update={"seed": 1}))

    def test_a_split_without_share_takes_pinned_recordings_only(self):
        splits = Splits(shares={"all": 1.0, "none": 0.0}, pinned={"drive_7": "none"}, seed=3)
        assert [key for key, name in deal(KEYS, splits).items() if name == "none"] == ["drive_7"]

    def test_in_a_large_set_a_pin_moves_its_recording_and_no_other(self):
        before = deal(KEYS, SPLITS)
        val = next(key for key in KEYS if before[key] == "val")
        after = deal(KEYS, SPLITS.model_copy(update={"pinned": {val: "train"}}))
        assert moves(before, after) == {val: ("val", "train")}

    def test_pins_count_for_the_share_of_their_split(self):
        splits = Splits(pinned={"drive_0": "val", "drive_1": "val"})
        assert counts(deal(KEYS[:10], splits)) == {"train": 8, "val": 2}
        splits = Splits(pinned=dict.fromkeys(KEYS[:8], "train"))
        assert counts(deal(KEYS[:10], splits)) == {"train": 8, "val": 2}

    def test_pinning_all_keeps_them_where_they_are_whatever_arrives(self):
        before = deal(KEYS[:6], DEFAULT)
        pinned = Splits(pinned=before)
        for number in range(7, 40):
            assert moves(before, deal(KEYS[:number], pinned)) == {}

    def test_more_pins_than_a_share_leave_no_other_split_empty(self):
        splits = Splits(pinned=dict.fromkeys(KEYS[:8], "val"))
        assert counts(deal(KEYS[:9], splits)) == {"train": 1, "val": 8}

    def test_the_field_may_be_called_pin(self):
        splits = Splits.model_validate({"pin": {"drive_1": "val"}})
        assert splits == Splits(pinned={"drive_1": "val"})

    def test_names_that_the_devkit_answers_itself_are_renamed(self):
        assert devkit_split_name("train") == "custom_train"
        assert devkit_split_name("night") == "night"
        assert not {devkit_split_name(name) for name in DEVKIT_SPLITS} & DEVKIT_SPLITS
        # nuscenes.utils.splits.create_splits_scenes
        theirs = ("train", "val", "test", "mini_train", "mini_val", "train_detect", "train_track")
        assert [devkit_split_name(name) for name in theirs] == [f"custom_{name}" for name in theirs]
        assert devkit_split_name("holdout") == "holdout"


class TestShares:
    @given(st.lists(st.tuples(st.sampled_from(KEYS), st.floats(0.1, 1000)), unique_by=lambda pair: pair[0]))
    def test_they_account_for_every_recording_and_second(self, durations):
        shares = shares_of(durations, SPLITS, deal([key for key, _ in durations], SPLITS))
        assert [share.name for share in shares] == ["test", "train", "val"]
        assert sum(share.recordings for share in shares) == len(durations)
        assert sum(share.duration_s for share in shares) == pytest.approx(sum(s for _, s in durations))
        if durations:
            assert sum(share.deviation for share in shares) == pytest.approx(0.0, abs=1e-9)

    def test_the_deviation_is_by_time_not_by_number(self):
        splits = Splits(shares={"a": 0.5, "b": 0.5}, pinned={"long": "a", "short": "b"})
        a, b = shares_of([("long", 30.0), ("short", 10.0)], splits, deal(["long", "short"], splits))
        assert (a.recordings, b.recordings) == (1, 1)
        assert (a.deviation, b.deviation) == (0.25, -0.25)
        assert a.is_far
        assert b.is_far

    def test_an_empty_split_is_far_from_any_share(self):
        a, b = shares_of([("one", 30.0)], Splits(shares={"a": 0.95, "b": 0.05}), {"one": "a"})
        assert (a.is_far, b.is_far) == (False, True)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("split")
    store = Store(folder / "store")
    parts = [
        Part(key, key, make_tables(store, Drive(seconds=2.0, seed=n), key=key).artifact.digest)
        for n, key in enumerate(["monday", "tuesday", "wednesday"])
    ]
    return store, parts, folder


class TestDataset:
    def test_the_dataset_says_which_recordings_moved(self, made):
        store, parts, folder = made
        splits = Splits(shares={"day": 0.5, "night": 0.5})
        found, summaries = [], []
        for number in (2, 3):
            summaries.append(
                assemble(NUSCENES, parts[:number], NuScenes(), store, folder / "grows", splits=splits)
            )
            lock = read_lock(folder / "grows" / "v1.0-custom").value
            found.append({bag["key"]: bag["split"] for bag in lock["bags"]})
        assert set(found[0].values()) == set(found[1].values()) == {"day", "night"}
        assert summaries[0].moved == {}
        assert summaries[1].moved == moves(*found)

    def test_a_dataset_of_some_recordings_keeps_the_splits_it_is_handed(self, made):
        store, parts, folder = made
        whole = {part.key: "val" for part in parts}
        assemble(NUSCENES, parts[:2], NuScenes(), store, folder / "some", dealt=whole)
        text = (folder / "some" / "v1.0-custom" / "splits.json").read_bytes()
        assert json.loads(text) == {"custom_train": [], "custom_val": ["monday_000", "tuesday_000"]}

    def test_pins_and_deviation_are_in_tables_and_lock(self, made):
        store, parts, folder = made
        splits = Splits(pinned={"monday": "val", "tuesday": "train", "wednesday": "val"})
        summary = assemble(NUSCENES, parts, NuScenes(), store, folder / "pinned", splits=splits)
        text = (folder / "pinned" / "v1.0-custom" / "splits.json").read_bytes()
        assert json.loads(text) == {
            "custom_train": ["tuesday_000"],
            "custom_val": ["monday_000", "wednesday_000"],
        }
        lock = read_lock(folder / "pinned" / "v1.0-custom").value
        assert lock["splits"] == splits.model_dump(mode="json")
        assert lock["shares"]["val"]["recordings"] == 2
        assert lock["shares"]["val"]["deviation"] == pytest.approx(2 / 3 - 0.2, abs=1e-3)
        assert [share.name for share in summary.shares] == ["train", "val"]
