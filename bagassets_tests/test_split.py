"""The split by recording: nothing ever moves a recording but its pin, the seed and the shares."""

import json

import pytest
from handmade import Drive, make_tables
from hypothesis import given
from hypothesis import strategies as st

from bagassets.nuscenes.dataset import BagPart, assemble, read_lock
from bagassets.nuscenes.splits import DEVKIT_SPLITS, devkit_split_name
from bagassets.recipe.model import NuScenes
from bagassets.recipe.model_splits import Splits
from bagassets.splits import shares_of, split_of
from bagassets.store.store import Store

KEYS = [f"drive_{number}" for number in range(2000)]
SPLITS = Splits(shares={"train": 0.7, "val": 0.2, "test": 0.1})


def dealt(splits, keys=KEYS):
    return {key: split_of(key, splits) for key in keys}


class TestSplitOf:
    def test_shares_are_met_approximately(self):
        found = list(dealt(SPLITS).values())
        for name, share in SPLITS.shares.items():
            assert found.count(name) / len(KEYS) == pytest.approx(share, abs=0.03)

    def test_it_is_fixed_for_ever(self):
        found = [split_of(key, SPLITS) for key in KEYS[2:8]]
        assert found == ["train", "test", "train", "train", "train", "val"]
        reordered = Splits(shares=dict(reversed(SPLITS.shares.items())))
        assert dealt(reordered) == dealt(SPLITS)

    def test_growing_a_share_only_moves_recordings_into_it(self):
        before = dealt(Splits(shares={"a": 0.5, "b": 0.5}))
        after = dealt(Splits(shares={"a": 0.6, "b": 0.4}))
        assert all(after[key] == "a" for key in KEYS if before[key] == "a")
        assert 0.05 < sum(before[key] != after[key] for key in KEYS) / len(KEYS) < 0.15

    def test_another_seed_deals_anew(self):
        assert dealt(SPLITS) != dealt(SPLITS.model_copy(update={"seed": 1}))

    def test_a_split_without_share_takes_pinned_recordings_only(self):
        splits = Splits(shares={"all": 1.0, "none": 0.0}, pinned={"drive_7": "none"}, seed=3)
        assert [key for key, name in dealt(splits).items() if name == "none"] == ["drive_7"]

    def test_a_pin_moves_its_recording_and_no_other(self):
        val = next(key for key in KEYS if split_of(key, SPLITS) == "val")
        pinned = SPLITS.model_copy(update={"pinned": {val: "train"}})
        before, after = dealt(SPLITS), dealt(pinned)
        assert {key for key in KEYS if before[key] != after[key]} == {val}
        assert split_of(val, pinned) == "train"

    def test_names_that_the_devkit_answers_itself_are_renamed(self):
        assert devkit_split_name("train") == "custom_train"
        assert devkit_split_name("night") == "night"
        assert not {devkit_split_name(name) for name in DEVKIT_SPLITS} & DEVKIT_SPLITS


class TestShares:
    @given(st.lists(st.tuples(st.sampled_from(KEYS), st.floats(0.1, 1000)), unique_by=lambda pair: pair[0]))
    def test_they_account_for_every_recording_and_second(self, durations):
        shares = shares_of(durations, SPLITS)
        assert [share.name for share in shares] == ["test", "train", "val"]
        assert sum(share.recordings for share in shares) == len(durations)
        assert sum(share.duration_s for share in shares) == pytest.approx(sum(s for _, s in durations))
        if durations:
            assert sum(share.deviation for share in shares) == pytest.approx(0.0, abs=1e-9)

    def test_the_deviation_is_by_time_not_by_number(self):
        splits = Splits(shares={"a": 0.5, "b": 0.5}, pinned={"long": "a", "short": "b"})
        a, b = shares_of([("long", 30.0), ("short", 10.0)], splits)
        assert (a.recordings, b.recordings) == (1, 1)
        assert (a.deviation, b.deviation) == (0.25, -0.25)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("split")
    store = Store(folder / "store")
    parts = [
        BagPart(key, key, make_tables(store, Drive(seconds=2.0, seed=n), key=key).artifact.digest)
        for n, key in enumerate(["monday", "tuesday", "wednesday"])
    ]
    return store, parts, folder


class TestDataset:
    def test_adding_a_recording_leaves_the_others_where_they_are(self, made):
        store, parts, folder = made
        splits = Splits(shares={"day": 0.5, "night": 0.5})
        found = []
        for number in (2, 3):
            assemble(parts[:number], NuScenes(), store, folder / "grows", splits=splits)
            text = (folder / "grows" / "v1.0-custom" / "splits.json").read_bytes()
            found.append({scene: name for name, scenes in json.loads(text).items() for scene in scenes})
        assert len(found[1]) == 3
        assert found[0].items() <= found[1].items()

    def test_pins_and_deviation_are_in_tables_and_lock(self, made):
        store, parts, folder = made
        splits = Splits(pinned={"monday": "val", "tuesday": "train", "wednesday": "val"})
        summary = assemble(parts, NuScenes(), store, folder / "pinned", splits=splits)
        text = (folder / "pinned" / "v1.0-custom" / "splits.json").read_bytes()
        assert json.loads(text) == {
            "custom_train": ["tuesday_000"],
            "custom_val": ["monday_000", "wednesday_000"],
        }
        lock = read_lock(folder / "pinned", "v1.0-custom")
        assert lock["splits"] == splits.model_dump(mode="json")
        assert lock["shares"]["val"]["recordings"] == 2
        assert lock["shares"]["val"]["deviation"] == pytest.approx(2 / 3 - 0.2, abs=1e-3)
        assert [share.name for share in summary.shares] == ["train", "val"]
