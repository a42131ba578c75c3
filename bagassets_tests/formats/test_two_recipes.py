"""Two recipes whose datasets would be in one folder: neither replaces what the other has made."""

import errno
import shutil

import pytest

from bagassets.propose.project import write_project
from bagassets_tests.in_process import QUICK, build, make_project

pytestmark = pytest.mark.once

VISION = QUICK.replace("nuscenes: {{version: v1.0-test}}\n", "vision: {{frames: 4}}\n")


def second_project(first, edit, name="other-"):
    """Write another project, with a dataset where that of the first one is."""
    text = first.read_text().replace("{version", "{output: ../dataset/nuscenes, version")
    text = text.replace("vision: {", "vision: {output: ../dataset/vision, ").replace(
        "root: bags", "root: ../bags"
    )
    write_project(first.parent / "second", edit(text).replace("name: ", f"name: {name}"))
    return first.parent / "second" / "recipe.yaml"


def with_shorter_scenes(text):
    return text.replace("min_length_s: 0.5", "min_length_s: 0.2, length_s: 0.5").replace(
        "frames: 4", "frames: 3"
    )


@pytest.mark.parametrize(
    ("text", "folder"), [(QUICK, "nuscenes"), (VISION, "vision")], ids=["tables", "folders"]
)
def test_the_dataset_of_another_recipe_is_not_replaced(text, folder, tmp_path, monkeypatch):
    first = make_project(tmp_path, text=text)
    build(first, monkeypatch)
    second = second_project(first, with_shorter_scenes)
    output = tmp_path / "dataset" / folder
    (lock,) = output.glob("*/dataset.lock.json")
    before = lock.read_bytes()
    report, _ = build(second, monkeypatch)
    assert report.dataset == "failed"
    assert (
        f"{lock.parent}: this is the dataset of {first}, and that of {second} would replace it; name another output in one "
        "of these recipes, or remove the folder." in report.dataset_problem
    )
    assert lock.read_bytes() == before
    assert not [*output.glob("*.tmp-*")]
    report, runs = build(first, monkeypatch)
    assert (report.dataset, runs) == ("fresh", [])

    moved = first.with_name("moved.yaml")
    first.rename(moved)  # so nobody else has a dataset there
    assert build(second, monkeypatch)[0].dataset == "updated"
    moved.rename(first)
    assert build(first, monkeypatch)[0].dataset == "failed"
    shutil.rmtree(lock.parent)
    assert build(first, monkeypatch)[0].dataset == "updated"
    assert build(second, monkeypatch)[0].dataset == "failed"


def test_another_checkout_of_a_project_brings_its_dataset_up_to_date(tmp_path, monkeypatch):
    first = make_project(tmp_path)
    build(first, monkeypatch)
    assert build(second_project(first, with_shorter_scenes, name=""), monkeypatch)[0].dataset == "updated"


def test_other_versions_in_one_dataroot_do_not_replace_each_other(tmp_path, monkeypatch):
    first = make_project(tmp_path)
    build(first, monkeypatch)
    second = second_project(first, lambda text: text.replace("v1.0-test", "v1.0-other"))
    assert build(second, monkeypatch)[0].dataset == "updated"
    assert build(first, monkeypatch)[0].dataset == "fresh"


def test_a_copied_project_owns_its_datasets(tmp_path, monkeypatch):
    first = make_project(tmp_path / "first")
    build(first, monkeypatch)
    shutil.copytree(tmp_path / "first", tmp_path / "copy")
    copy = tmp_path / "copy" / "recipe.yaml"
    (copy.parent / ".env").unlink()
    write_project(copy.parent, with_shorter_scenes(copy.read_text()).replace("name: ", "name: other-"))
    assert build(copy, monkeypatch)[0].dataset == "updated"
    assert build(first, monkeypatch)[0].dataset == "fresh"


def test_where_files_have_no_attributes_datasets_are_made_as_ever(tmp_path, monkeypatch):
    def no_attributes(*_):
        raise OSError(errno.ENOTSUP, "Operation not supported")

    monkeypatch.setattr("os.getxattr", no_attributes)
    monkeypatch.setattr("os.setxattr", no_attributes)
    first = make_project(tmp_path)
    assert build(first, monkeypatch)[0].dataset == "updated"
    assert build(second_project(first, with_shorter_scenes), monkeypatch)[0].dataset == "updated"
