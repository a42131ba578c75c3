"""The first build of a new version says what it makes again, why, and about how long that takes."""

from types import SimpleNamespace

import pytest

from bagassets.base.quantities import readable_time
from bagassets.engine.made_again import made_again
from bagassets.engine.plan import AssetState, BagPlan, Plan, Recorded
from bagassets.formats.catalogue import known_assets, recording_assets
from bagassets.recipe.load import parse_recipe
from bagassets.recordings.discover import Discovery
from bagassets.recordings.model import RecordingFiles
from bagassets_tests.small_drive import RECIPE

pytestmark = pytest.mark.once

WHY = "as far as this version of bagassets makes them differently (see its changelog)"


class Actions:
    """Of each recording's frames, two channels that shared a pass of 60 s; any other asset took 10 s."""

    def action(self, digest):
        channels = {"CAM_A": f"{digest}/A", "CAM_B": f"{digest}/B"} if digest == "frames" else None
        return {"params": {"actions": channels} if channels else {}}

    def seconds(self, digest):
        return {"frames": 0.01, "frames/A": 60.0, "frames/B": 59.0}.get(digest, 10.0)


@pytest.fixture
def said(tmp_path):
    assets = recording_assets(parse_recipe(RECIPE.format(name="x", root="bags"), tmp_path / "recipe.yaml"))

    def of(*bags, jobs=1, store=None, sizes=1000):
        """Bags: (key, assets that are not fresh, those whose version was raised), or their names alone for frames."""
        plan, recorded = {}, {}
        for key, states, raised in bags:
            plan[key] = BagPlan(
                key, {name: AssetState(states.get(name, "fresh"), "") for name in ("bag", *assets.names)}
            )
            recorded[key] = {
                name: Recorded("d", f"{assets[name].version - (name in raised)}-0123456789ab", action=name)
                for name in assets.names
            } | {"bag": Recorded("d", "0")}
        todo = dict.fromkeys(plan, ("bag", *assets.names))
        found = {key: RecordingFiles(key, key, tmp_path / key, "ros1", (), sizes, 0) for key in plan}
        planned = Plan(plan, {}, (), recorded=recorded, discovery=Discovery(found, []))
        assets.store = store or Actions()
        return made_again(assets, planned, todo, jobs)

    return of


def first_line(text):
    return text.partition("\n")[0]


STATES = {"frames": "stale", "nuscenes_tables": "unknown", "preview": "unknown"}


def test_frames_of_all_recordings_are_told_once_with_the_time_that_they_took(said):
    bags = [(f"{number:03}.bag", STATES, {"frames"}) for number in range(300)]
    # A pass of 60 s, and 10 s each for the tables and the pictures made of it: 300 times, two at a time, in 6 runs.
    assert first_line(said(*bags, jobs=2)) == (
        f"made again: frames of 300 recordings (000.bag, 001.bag, 002.bag and 297 more), {WHY}; about 3.3 h, going by what "
        "they took before"
    )
    hours = (6 + 300 * (60 + 2 * 10)) / 2 / 3600
    assert hours == pytest.approx(3.3, abs=0.05)


def test_only_what_was_raised_is_named_and_only_what_follows_takes_time(said):
    touched = dict.fromkeys(("bag", "inventory", "calibration", *STATES), "unknown")
    assert said(("a.bag", touched, {"frames"})).startswith(f"made again: frames of a.bag, {WHY}; about 81 s,")
    both = said(("a.bag", STATES, {"frames", "nuscenes_tables"}), ("b.bag", STATES, {"nuscenes_tables"}))
    assert both.startswith(f"made again: frames, nuscenes_tables of a.bag; nuscenes_tables of b.bag, {WHY}; ")


def test_a_changed_recipe_or_recording_is_not_the_versions_fault(said):
    assert said(("a.bag", STATES, set())) == ""
    assert said(("a.bag", {}, {"frames"})) == ""  # raised, but the store has the result
    assert said(("a.bag", {"frames": "failed"}, {"frames"})) == ""
    assert said() == ""


def test_without_records_of_the_time_none_is_told(said):
    gone = SimpleNamespace(action=lambda _: None, seconds=lambda _: 0.0)
    told = said(("a.bag", STATES, {"frames"}), store=gone)
    assert first_line(told) == f"made again: frames of a.bag, {WHY}"
    told = said(("a.bag", STATES, {"frames"}), sizes=0)
    assert first_line(told).endswith("; about 81 s, going by what they took before")


def test_each_asset_says_what_is_different_now(said):
    states = {**STATES, "inventory": "stale", "calibration": "unknown"}
    _, *lines = said(
        ("a.bag", states, {"frames", "inventory"}), ("b.bag", states, {"inventory"})
    ).splitlines()
    assets = {asset.name: asset for asset in known_assets()}
    assert lines == [
        f"  {name} {assets[name].changes[assets[name].version]}" for name in ("inventory", "frames")
    ]


def test_versions_raised_since_the_first_release_say_what_they_changed():
    released = {"inventory": 6, "calibration": 3, "ego_poses": 3, "frames": 5, "sweeps": 3, "preview": 6}
    released |= {"nuscenes_tables": 6, "annotations": 3, "vision_sequences": 2}
    for asset in known_assets():
        first = released.get(asset.name, 1)  # those that came later began with 1
        assert list(asset.changes) == list(range(first + 1, asset.version + 1)), asset.name


def test_rough_times_have_a_unit_that_fits():
    assert [readable_time(seconds) for seconds in (0.1, 42.4, 99.4, 99.6, 2400, 5969, 5971, 86400)] == [
        "1 s", "42 s", "99 s", "2 min", "40 min", "99 min", "1.7 h", "24.0 h",
    ]  # fmt: skip
