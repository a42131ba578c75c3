"""The pictures of the store that `bagassets ui` serves, and nothing else."""

import pytest

from bagassets.build.run_action import run_action
from bagassets.defs.artifact_files import picture_file
from bagassets.errors import StoreError
from bagassets.recipe import load_recipe
from bagassets.store.action import Step
from bagassets.store.store import Store
from bagassets_tests.in_process import make_project

FILES = {"a.jpg": b"picture", "inline/a.png": b"small", "page.html": b"<script>", "facts.json": b"{}"}


@pytest.fixture
def artifact(tmp_path, monkeypatch):
    recipe_file = make_project(tmp_path, [])
    monkeypatch.setenv("BAGASSETS_RECIPE", str(recipe_file))

    def write(out):
        for name, content in FILES.items():
            out.write(name, content)
        return {}

    return run_action(
        Store(load_recipe(recipe_file).store_path), Step("test", 1).action({}, {}), write
    ).artifact


@pytest.mark.parametrize("name", ["a.jpg", "inline/a.png"])
def test_pictures_of_artifacts_are_found(artifact, name):
    assert picture_file(artifact.digest, name).read_bytes() == FILES[name]


@pytest.mark.parametrize(
    "name",
    [
        "page.html",
        "facts.json",
        "b.jpg",
        "../manifest.json",
        "../../x.jpg",
        "inline/../a.jpg",
        "/x.jpg",
        "",
        "a.jpg/",
    ],
)
def test_nothing_else_is(artifact, name):
    (artifact.folder.parent / "x.jpg").write_bytes(b"outside")
    assert picture_file(artifact.digest, name) is None


@pytest.mark.parametrize("digest", ["abc", "..", "", "0" * 63 + "/", "../" + "0" * 64])
def test_a_digest_is_a_digest(artifact, digest):
    assert picture_file(digest, "a.jpg") is None


def test_what_is_not_there_is_missing(artifact):
    with pytest.raises(StoreError, match="not in the store"):
        picture_file("0" * 64, "a.jpg")
    artifact.path("a.jpg").unlink()
    assert picture_file(artifact.digest, "a.jpg") is None
