"""What a dataset takes of a recording is all of one content: never old scenes under the digest of a new file."""

import json
import shutil

import pytest

from bagassets.defs.graph import making
from bagassets.recipe import load_recipe
from bagassets_tests.in_process import build, make_project
from bagassets_tests.small_drive import write_drive

pytestmark = pytest.mark.once

KEYS = ["a.bag", "b.bag", "c.mcap"]
LOCK = "v1.0-test/dataset.lock.json"
OUTDATED = "its content has changed since its nuscenes_tables was made; build it again."


@pytest.fixture
def project(tmp_path, monkeypatch):
    """A project that is up to date."""
    recipe_file = make_project(tmp_path / "project", KEYS, duration_s=2.0)
    write_drive(tmp_path / "other.bag", "ros1", duration_s=2.4)
    write_drive(tmp_path / "third.mcap", "mcap", duration_s=2.8)
    bags = recipe_file.parent / "bags"
    shutil.copy(tmp_path / "other.bag", bags / "b.bag")
    assert build(recipe_file, monkeypatch)[0].succeeded
    return recipe_file


def lock(recipe_file):
    return json.loads((load_recipe(recipe_file).nuscenes.output / LOCK).read_text())


def contents(recipe_file):
    """Recording in the dataset -> content and part."""
    return {bag["key"]: (bag["content"], bag["artifacts"][0]) for bag in lock(recipe_file)["bags"]}


def settled(recipe_file, monkeypatch):
    assert build(recipe_file, monkeypatch)[0].succeeded
    assert build(recipe_file, monkeypatch)[1] == []
    return contents(recipe_file)


def replace_a_and_another(recipe_file, tmp_path, a):
    shutil.copy(a, recipe_file.parent / "bags" / "a.bag")
    shutil.copy(tmp_path / "third.mcap", recipe_file.parent / "bags" / "c.mcap")


def test_a_recording_of_which_only_some_assets_are_new_is_left_out(project, tmp_path, monkeypatch):
    before = contents(project)
    write_drive(tmp_path / "new.bag", "ros1", duration_s=3.2)
    replace_a_and_another(project, tmp_path, tmp_path / "new.bag")
    assert build(project, monkeypatch, select=("inventory",), bags=("a.bag",))[0].succeeded
    assert contents(project) == before, "the dataset was not asked for"
    report = build(project, monkeypatch, bags=("c.mcap",))[0]
    assert report.succeeded
    assert report.left_out == {"a.bag": OUTDATED}
    made = contents(project)
    assert made.keys() == {"b.bag", "c.mcap"}
    assert made["b.bag"] == before["b.bag"]
    assert lock(project)["failed"] == {"a.bag": OUTDATED}
    after = settled(project, monkeypatch)
    assert after.keys() == before.keys()
    assert all(new != old for new, old in zip(after["a.bag"], before["a.bag"], strict=True))
    assert lock(project)["failed"] == {}


def test_new_content_of_which_nothing_was_made_is_no_copy_of_another(project, tmp_path, monkeypatch):
    before = contents(project)
    replace_a_and_another(project, tmp_path, project.parent / "bags" / "b.bag")
    assert build(project, monkeypatch, select=("inventory",), bags=("a.bag",))[0].succeeded
    report = build(project, monkeypatch, bags=("c.mcap",))[0]
    assert report.duplicates == {}
    assert contents(project)["b.bag"] == before["b.bag"]
    settled(project, monkeypatch)
    assert lock(project)["duplicates"] == {"b.bag": "a.bag"}


def test_a_recording_that_changes_after_it_was_hashed_is_left_out(project, tmp_path, monkeypatch):
    before = contents(project)
    path = project.parent / "bags" / "a.bag"
    shutil.copy(tmp_path / "third.mcap", project.parent / "bags" / "c.mcap")
    write_drive(tmp_path / "new.bag", "ros1", duration_s=3.2)
    write_drive(tmp_path / "newest.bag", "ros1", duration_s=3.6)
    shutil.copy(tmp_path / "new.bag", path)
    graph = making.Graph

    def change_first(*args, **options):
        if args[1].path == path:
            shutil.copy(tmp_path / "newest.bag", path)
        return graph(*args, **options)

    with monkeypatch.context() as patch:
        patch.setattr(making, "Graph", change_first)
        report = build(project, monkeypatch)[0]
    assert not report.succeeded
    assert "a.bag" not in contents(project)
    assert lock(project)["failed"].keys() == {"a.bag"}
    assert settled(project, monkeypatch).keys() == before.keys()


def test_assets_that_are_made_alone_after_a_change_of_the_recipe_cost_nothing(project, tmp_path, monkeypatch):
    """They are newer than the tables, but of the same content."""
    before = contents(project)
    text = project.read_text()
    changed = text.replace("modality: camera,", "modality: camera, quality: 30,")
    assert changed != text
    project.write_text(changed)
    shutil.copy(tmp_path / "third.mcap", project.parent / "bags" / "c.mcap")
    assert build(project, monkeypatch, select=("frames",), bags=("a.bag",))[0].succeeded
    assert build(project, monkeypatch, bags=("c.mcap",))[0].succeeded
    made = contents(project)
    assert made["a.bag"] == before["a.bag"]
    after = settled(project, monkeypatch)
    assert after["a.bag"][0] == before["a.bag"][0]
    assert after["a.bag"][1] != before["a.bag"][1]


def test_a_lock_says_why_a_recording_failed_in_the_same_words_wherever_it_lies(project, monkeypatch):
    torn = project.parent / "bags" / "c.mcap"
    torn.write_bytes(torn.read_bytes()[:40])
    build(project, monkeypatch)
    (reason,) = lock(project)["failed"].values()
    assert lock(project)["failed"] == {"c.mcap": reason}
    assert reason.startswith("it ")
    assert str(project.parent) not in reason
