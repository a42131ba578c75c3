"""The plan: what it remembers, what it tells, and which recordings and assets are meant."""

import json
import os
import sqlite3
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bagassets.base.cache import NAME
from bagassets.base.errors import RecordingError, SelectionError
from bagassets.defs.builds.pending_work import open_project
from bagassets.engine import planner
from bagassets.engine.choose import choose_assets, choose_recordings
from bagassets.engine.differences import compare_actions, describe_changes, flatten
from bagassets.engine.freshness.plan_cache import PlanCache
from bagassets.engine.plan import AssetState, BagPlan
from bagassets.formats.catalogue import recording_assets
from bagassets.recipe import load_recipe
from bagassets.recipe.model import Recipe
from bagassets.recordings.model import RecordingFiles
from bagassets_tests.in_process import build, make_project, survey
from bagassets_tests.recording_build import RECORDING_ASSETS

pytestmark = pytest.mark.once

KEY = "a.bag"
CAMERA = {"modality": "camera", "topic": "/cam"}
POSE = {"source": "odometry", "topic": "/odom"}
MINIMAL = {
    "name": "test",
    "bags": {"root": "bags"},
    "rigs": [{"name": "car", "ego_pose": POSE, "channels": {"CAM_FRONT": CAMERA}}],
}


# --- what differs -------------------------------------------------------------------------


def action(**fields):
    return {"step": "frames", "version": 1, "libraries": {}, "params": {}, "inputs": {}} | fields


def test_differences_are_reported_by_name_with_both_values():
    before = action(
        params={"quality": 90, "camera": {"k": [1], "width": 8}}, inputs={"topic:/a": "1", "topic:/b": "1"}
    )
    now = action(
        version=2,
        params={"quality": 50, "camera": {"k": [2], "width": 8}, "new": True},
        inputs={"topic:/a": "2"},
    )
    found = compare_actions(before, now)
    assert [str(change) for change in found] == [
        "step version 1 -> 2",
        "camera.k changed",
        "new is new",
        "quality 90 -> 50",
        "topic /a changed",
        "topic /b is gone",
    ]
    assert describe_changes(found) == "step version 1 -> 2, camera.k changed, quality 90 -> 50 and 2 more"
    assert describe_changes([]) == ""


def test_nested_values_that_are_all_new_or_all_gone_are_one_change():
    before = action(params={"a": {"b": {"c": 1, "d": 2}}, "e": {}})
    now = action(params={"a": {}, "e": {"f": {"g": 1, "h": 2}}})
    found = compare_actions(before, now)
    assert [str(change) for change in found] == ["a is gone", "e is new"]
    assert [change.name for change in compare_actions(now, before)] == ["a", "e"]


json_objects = st.recursive(
    st.dictionaries(st.text("abc", min_size=1), st.integers()),
    lambda inner: st.dictionaries(st.text("abc", min_size=1), inner | st.integers()),
    max_leaves=8,
)


@given(json_objects, json_objects)
def test_there_is_a_change_exactly_where_values_differ(before, now):
    found = compare_actions(action(params=before), action(params=now))
    assert (found == []) == (dict(flatten(before)) == dict(flatten(now)))
    for change in found:
        assert change.before != change.now


# --- what a run takes ---------------------------------------------------------------------


def bag(**states):
    assets = {name: AssetState(states.get(name, "fresh"), "why") for name in RECORDING_ASSETS}
    return BagPlan(KEY, assets)


@pytest.mark.parametrize(
    ("states", "runs"),
    [
        ({}, False),
        ({"frames": "skipped"}, False),
        ({"frames": "stale"}, True),
        ({"frames": "record-only"}, True),
        ({"frames": "missing"}, True),
        ({"bag": "stale", "frames": "unknown"}, True),
        ({"ego_poses": "failed", "nuscenes_tables": "unknown"}, False),
        ({"ego_poses": "failed", "nuscenes_tables": "unknown", "frames": "stale"}, True),
    ],
)
def test_a_run_is_needed_when_something_can_come_of_it(states, runs):
    assert bool(bag(**states).to_run()) == runs
    assert bag(**states).settled == (set(states.values()) <= {"fresh", "skipped"})


def test_a_failure_is_tried_again_only_if_asked_for():
    failed = bag(ego_poses="failed", nuscenes_tables="unknown")
    assert failed.to_run() == ()
    assert failed.to_run(retry_failed=True) == RECORDING_ASSETS
    assert failed.failed == failed.unusable == "why"


def test_selected_assets_bring_what_they_read():
    with_upstream = recording_assets(Recipe.model_validate(MINIMAL)).with_upstream
    assert with_upstream(["frames"]) == ("bag", "inventory", "calibration", "frames")
    assert with_upstream(["bag", "nuscenes_dataset"]) == ("bag",)
    assert with_upstream(["calibration", "ego_poses"]) == ("bag", "inventory", "calibration", "ego_poses")
    assert bag(sweeps="stale").to_run(select=with_upstream(["frames"])) == ()
    assert bag(calibration="stale").to_run(select=with_upstream(["frames"])) == (
        "bag",
        "inventory",
        "calibration",
        "frames",
    )


# --- what is meant ------------------------------------------------------------------------


@pytest.fixture
def recordings(tmp_path):
    names = {"monday.bag": "monday.bag", "runs__tuesday": "runs/tuesday"}
    return {k: RecordingFiles(k, r, tmp_path / r, "ros1", (tmp_path / r,), 1, 1) for k, r in names.items()}


@pytest.mark.parametrize(
    ("wanted", "keys"),
    [
        (["monday.bag"], {"monday.bag"}),
        (["runs/tuesday"], {"runs__tuesday"}),
        (["runs*"], {"runs__tuesday"}),
        (["*", "monday.bag"], {"monday.bag", "runs__tuesday"}),
    ],
)
def test_recordings_are_meant_by_key_path_or_glob(recordings, wanted, keys):
    assert choose_recordings(recordings, wanted) == keys


def test_a_path_means_the_recording_there(recordings, tmp_path):
    assert choose_recordings(recordings, [str(tmp_path / "runs" / "tuesday")]) == {"runs__tuesday"}


def test_what_means_nothing_is_refused_with_the_nearest(recordings):
    with pytest.raises(SelectionError, match=r"did you mean monday\.bag"):
        choose_recordings(recordings, ["munday.bag"])
    with pytest.raises(SelectionError, match="frames"):
        choose_assets(["frames", "sweeps"], ["sweeps,frame"])
    assert choose_assets(["frames", "sweeps"], ["sweeps, frames"]) == {"frames", "sweeps"}
    assert choose_assets(["frames"], []) is None


# --- what is remembered -------------------------------------------------------------------


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    return make_project(tmp_path_factory.mktemp("plan"), [KEY, "b.mcap"], duration_s=2.0)


@pytest.fixture
def built(project, monkeypatch):
    report, _ = build(project, monkeypatch)
    assert report.succeeded
    return project


def looked_into(recipe_file, monkeypatch):
    """Return the recordings that a plan looks into."""
    keys = []
    plan = planner.plan_recording

    def note(graph):
        keys.append(graph.recording.key)
        return plan(graph)

    with monkeypatch.context() as patch:
        patch.setattr(planner, "plan_recording", note)
        survey(recipe_file)
    return keys


def test_recordings_that_are_as_they_were_are_not_looked_into(built, monkeypatch):
    assert looked_into(built, monkeypatch) == []
    before = survey(built).plan.bags
    (load_recipe(built).state / NAME).unlink()
    assert looked_into(built, monkeypatch) == [KEY, "b.mcap"]
    assert survey(built).plan.bags == before, "a remembered plan is the plan"


def test_only_the_recording_that_changed_is_looked_into(built, monkeypatch):
    (built.parent / "bags" / KEY).touch()
    assert looked_into(built, monkeypatch) == [KEY]


def test_another_recipe_has_all_looked_into(built, monkeypatch):
    text = built.read_text()
    built.write_text(text + "# a comment\n")
    assert looked_into(built, monkeypatch) == [KEY, "b.mcap"]
    built.write_text(text)


@pytest.mark.parametrize("damage", [b"", b"no database", None])
def test_a_damaged_memory_costs_time_only(built, monkeypatch, damage):
    path = load_recipe(built).state / NAME
    if damage is None:
        with sqlite3.connect(path) as connection:
            connection.execute("UPDATE entries SET content = '[1]' WHERE kind = 'recordings'")
        connection.close()
    else:
        path.write_bytes(damage)
    assert looked_into(built, monkeypatch) == [KEY, "b.mcap"]
    assert looked_into(built, monkeypatch) == [], "it was made anew"


def test_a_memory_that_cannot_be_written_is_no_error(tmp_path):
    (tmp_path / NAME).mkdir()
    cached = PlanCache(tmp_path, tmp_path)
    cached.save({}, ["gone"])
    assert cached.load() == {}


def test_a_recording_that_comes_back_is_a_hit(built, monkeypatch):
    path = built.parent / "bags" / "b.mcap"
    aside = path.rename(built.parent / "aside.mcap")
    report, runs = build(built, monkeypatch)
    assert report.removed == ("b.mcap",)
    assert report.dataset == "updated"
    assert [key for key, _ in runs if key] == []
    aside.rename(path)
    report, _ = build(built, monkeypatch)
    assert report.outcomes["b.mcap"].result == "hit"
    assert report.dataset == "updated"


def test_a_recording_in_a_folder_that_cannot_be_read_is_not_removed(built, monkeypatch):
    folder = built.parent / "bags" / "day"
    folder.mkdir()
    (built.parent / "bags" / "b.mcap").rename(folder / "b.mcap")
    build(built, monkeypatch)
    scandir = os.scandir

    def refuse(path):
        if str(path) == str(folder):
            raise PermissionError(13, "Permission denied", str(path))
        return scandir(path)

    monkeypatch.setattr(os, "scandir", refuse)
    report, _ = build(built, monkeypatch)
    assert report.removed == ()
    assert report.outcomes[KEY].result == "fresh"
    assert report.excluded["day"].startswith("cannot be read: permissions;")
    monkeypatch.setattr(os, "scandir", scandir)
    report, runs = build(built, monkeypatch)
    assert report.outcomes["day__b.mcap"].result == "fresh"
    assert [key for key, _ in runs if key] == []


def test_a_missing_bag_root_is_reported_with_the_line_of_the_recipe(built):
    text = built.read_text()
    line = 1 + next(n for n, one in enumerate(text.splitlines()) if "root: bags" in one)
    built.write_text(text.replace("root: bags", "root: /nonexistent"))
    with pytest.raises(RecordingError) as caught:
        survey(built)
    assert str(caught.value).startswith(f"{built}:{line}: bags.root: there is no folder /nonexistent; ")
    built.write_text(text)


def test_a_plan_of_dagsters_empty_log_is_all_records(built, monkeypatch):
    with open_project(built) as workspace:
        instance = workspace.instance
        live = frozenset(workspace.discover().recordings)
        for key in live:
            instance.delete_dynamic_partition(f"{workspace.recipe.name}_recordings", key)
    states = {s.state for b in survey(built).plan.bags.values() for n, s in b.assets.items() if n != "bag"}
    assert states == {"record-only"}
    assert json.dumps(survey(built).plan.bags[KEY].as_json())
    assert Path(built).is_file()


def test_whether_to_try_again_goes_by_the_failure_that_is_told():
    wrong, lost = AssetState("failed", "no topic", is_final=True), AssetState("failed", "killed")
    for first, second in ((wrong, lost), (lost, wrong)):
        plan = BagPlan(KEY, {"ego_poses": first, "preview": second})
        assert (plan.failed, plan.can_be_retried) == (first.reason, first is lost)
