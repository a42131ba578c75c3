"""What a build says of disk space beforehand, and when it refuses."""

import shutil
from dataclasses import replace
from types import SimpleNamespace

import pytest

from bagassets.base.errors import StoreError
from bagassets.cli.progress import LinesProgress
from bagassets.engine import disk_space
from bagassets.engine.build_report import Event
from bagassets.engine.disk_space import SpaceNeeded, folders_written, require_disk_space, space_needed
from bagassets.engine.plan import AssetState, BagPlan, Plan
from bagassets.formats.catalogue import recording_assets
from bagassets.recipe import load_recipe, parse_recipe
from bagassets.store.store import Store
from bagassets_tests.in_process import QUICK, build, make_project, survey
from bagassets_tests.recording_build import ASSETS
from bagassets_tests.small_drive import write_drive

pytestmark = pytest.mark.once


def free(monkeypatch, size):
    monkeypatch.setattr(shutil, "disk_usage", lambda _path: SimpleNamespace(free=size))


def bag(key, state, **others):
    states = dict.fromkeys(("bag", "frames", "sweeps"), state) | others
    return BagPlan(key, {name: AssetState(one, "") for name, one in states.items()})


def plan(*bags):
    return Plan({one.key: one for one in bags}, (), {})


def test_nothing_is_needed_where_images_and_sweeps_are_there(tmp_path):
    todo = bag("a", "fresh", nuscenes_tables="stale")
    assert space_needed(plan(todo), {"a": 1000}, ["a"], ASSETS) is None


@pytest.mark.parametrize("state", ["unknown", "stale"])
def test_what_was_made_before_may_be_there_still(tmp_path, state):
    touched = replace(bag("a", state), recorded={"frames": "0" * 64, "sweeps": "1" * 64})
    assert space_needed(plan(touched), {"a": 1000}, ["a"], ASSETS) is None
    assert space_needed(plan(bag("a", state)), {"a": 1000}, ["a"], ASSETS) is not None


def test_without_built_recordings_nobody_knows(tmp_path, monkeypatch):
    needed = space_needed(plan(bag("a", "missing")), {"a": 30_000_000_000}, ["a"], ASSETS)
    assert needed is not None
    assert str(needed) == (
        "Images and clouds to extract from 1 recording (30.0 GB): less disk space than that if recorded raw, several times as much if as "
        "video or lidar packets"
    )
    free(monkeypatch, 1_000_000)
    # Of 30 GB of raw images or unused topics anything may be left: nobody is refused for that.
    assert require_disk_space(needed, {"store": tmp_path}).endswith(f"; 1.0 MB free in {tmp_path}")


def test_much_too_little_is_refused_with_what_to_do(tmp_path, monkeypatch):
    needed = SpaceNeeded(6, 8_000_000_000, 3_000_000_000, is_measured=True)
    free(monkeypatch, 1_600_000_000)
    text = require_disk_space(needed, {"store": tmp_path / "not" / "yet"})
    assert text == (
        f"Images and clouds to extract from 6 recordings (8.0 GB): about 3.0 GB of disk space; 1.6 GB free in {tmp_path / 'not' / 'yet'}"
    )
    free(monkeypatch, 1_400_000_000)
    with pytest.raises(StoreError) as caught:
        require_disk_space(needed, {"store": tmp_path, "nuscenes.output": tmp_path / "other"})
    assert str(caught.value).startswith(
        f"{tmp_path}: only 1.4 GB are free here, and the build needs about 3.0 GB "
    )
    assert "set `store` in the recipe" in str(caught.value)
    assert "--ignore-disk-space" in str(caught.value)
    with pytest.raises(StoreError, match="for 1 recording, going by"):
        require_disk_space(replace(needed, recordings=1), {"store": tmp_path})


def test_a_dataset_on_another_disk_needs_space_of_its_own(tmp_path, monkeypatch):
    text = QUICK.format(name="test", root="bags") + "vision: {output: sequences}\n"
    recipe = parse_recipe(text, tmp_path / "recipe.yaml")
    assert folders_written(tmp_path / "store", recipe) == {"store": tmp_path / "store"}
    devices = {tmp_path / "store": 1, tmp_path / "dataset" / "nuscenes": 1, tmp_path / "sequences": 2}
    monkeypatch.setattr(disk_space, "_device", devices.__getitem__)
    assert folders_written(tmp_path / "store", recipe) == {
        "store": tmp_path / "store",
        "vision.output": tmp_path / "sequences",
    }
    devices[tmp_path / "dataset" / "nuscenes"] = 2
    assert list(folders_written(tmp_path / "store", recipe)) == ["store", "nuscenes.output", "vision.output"]


def test_a_build_measures_what_is_built_and_says_so(tmp_path, monkeypatch, capsys):
    recipe = make_project(tmp_path)
    build(recipe, monkeypatch)
    size = (tmp_path / "bags" / "a.bag").stat().st_size
    write_drive(tmp_path / "bags" / "b.bag", "ros1", 2.0)
    pending = survey(recipe)
    sizes = {key: one.size for key, one in pending.plan.discovery.recordings.items()}
    store = Store(tmp_path / ".bagassets" / "store")
    needed = space_needed(pending.plan, sizes, pending.todo, recording_assets(load_recipe(recipe)))
    assert needed.is_measured
    files = {
        file.stat().st_ino: file.stat().st_size for file in store.root.rglob("files/**/*") if file.is_file()
    }
    assert needed.bytes == pytest.approx(sum(files.values()) * sizes["b.bag"] / size, rel=0.2)

    with monkeypatch.context() as full:
        free(full, needed.bytes // 4)
        with pytest.raises(StoreError, match="go ahead with --ignore-disk-space"):
            build(recipe, full)
        report, runs = build(recipe, full, ignore_disk_space=True)
        assert runs
        assert report.succeeded
        # With nothing to do, nothing is looked at.
        full.setattr("bagassets.defs.builds.loop.space_needed", None)
        assert build(recipe, full)[1] == []


def test_the_log_says_what_is_needed(capsys):
    LinesProgress()(
        Event("planned", sizes={"a": 1}, message="1 recording (1 B): about 1 B of disk space; 2 B free in /d")
    )
    assert capsys.readouterr().err == (
        "1 recording needs a run.\n1 recording (1 B): about 1 B of disk space; 2 B free in /d\n"
    )
