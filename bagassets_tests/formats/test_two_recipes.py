"""Two recipes whose datasets are in one folder: each replaces that of the other, and says so."""

import shutil

import pytest

from bagassets.propose.project import write_project
from bagassets_tests.in_process import QUICK, build, make_project

pytestmark = pytest.mark.once

VISION = QUICK.replace("nuscenes: {{version: v1.0-test}}\n", "vision: {{frames: 4}}\n")


def second_project(first, edit):
    """Write another project, with its dataset where that of the first one is."""
    text = first.read_text().replace("root: bags", "root: ../bags").replace("name: ", "name: other-")
    for section, name in (("{version", "nuscenes"), ("{frames", "vision")):
        text = text.replace(section, section.replace("{", f"{{output: ../dataset/{name}, "))
    write_project(first.parent / "second", edit(text))
    return first.parent / "second" / "recipe.yaml"


def with_shorter_scenes(text):
    return text.replace("min_length_s: 0.5", "min_length_s: 0.2, length_s: 0.5").replace(
        "frames: 4", "frames: 3"
    )


def told(recipe_file, monkeypatch):
    """Build; return what is said of datasets that were replaced."""
    report, _ = build(recipe_file, monkeypatch)
    assert report.succeeded
    return [one.problem for one in report.remarks if one.check == "replaced"]


@pytest.mark.parametrize(
    ("text", "folder"),
    [(QUICK, "nuscenes/v1.0-test"), (VISION, "vision/annotations")],
    ids=["tables", "folders"],
)
def test_they_say_so_by_turns(text, folder, tmp_path, monkeypatch):
    first = make_project(tmp_path, ("a.bag",), text=text)
    assert told(first, monkeypatch) == []
    second = second_project(first, with_shorter_scenes)
    assert told(second, monkeypatch) == [], "it has made nothing there yet"
    for recipe_file in (first, second, first):
        (said,) = told(recipe_file, monkeypatch)
        assert said == (
            f"{tmp_path}/dataset/{folder}: something else has put another dataset here since this project made its own; if "
            "another project or checkout did, each replaces that of the other: give one of them another `output`."
        )
        assert told(recipe_file, monkeypatch) == []


def test_nothing_is_said_of_what_replaces_nothing(tmp_path, monkeypatch):
    first = make_project(tmp_path, ("a.bag",))
    build(first, monkeypatch)
    same = second_project(first, lambda text: text.replace("other-", ""))
    assert told(same, monkeypatch) == told(first, monkeypatch) == [], "they make the same bytes"
    beside = second_project(first, lambda text: with_shorter_scenes(text).replace("v1.0-test", "v1.0-other"))
    for recipe_file in (beside, first, beside):
        assert told(recipe_file, monkeypatch) == [], "another version in the same dataroot"
    (lock,) = tmp_path.glob("dataset/nuscenes/v1.0-test/dataset.lock.json")
    lock.write_bytes(bytes(10))
    assert told(first, monkeypatch) == [], "that is damage"
    shutil.rmtree(lock.parent)
    assert told(first, monkeypatch) == []


def test_a_copied_project_replaces_nothing(tmp_path, monkeypatch):
    first = make_project(tmp_path / "first", ("a.bag",))
    build(first, monkeypatch)
    shutil.copytree(tmp_path / "first", tmp_path / "copy")
    write_project(tmp_path / "copy", None)
    copy = tmp_path / "copy" / "recipe.yaml"
    copy.write_text(with_shorter_scenes(copy.read_text()))
    assert told(copy, monkeypatch) == told(first, monkeypatch) == told(copy, monkeypatch) == []
