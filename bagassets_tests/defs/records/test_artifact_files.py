"""The pictures of the store, the map and the report, which `bagassets ui` serves, and nothing else."""

import os
import re
from pathlib import Path

import pytest
from starlette.requests import Request
from starlette.responses import HTMLResponse
from starlette.routing import Route

from bagassets.base.errors import StoreError
from bagassets.defs.records.artifact_files import page_file, page_link, picture_file
from bagassets.defs.ui.webserver import page, styled
from bagassets.engine.run_action import run_action
from bagassets.formats.report_data import map_path, report_path
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


@pytest.fixture
def recipe(tmp_path, monkeypatch):
    recipe_file = make_project(tmp_path, [])
    monkeypatch.setenv("BAGASSETS_RECIPE", str(recipe_file))
    return load_recipe(recipe_file)


def asked(name):
    return page(Request({"type": "http", "method": "GET", "headers": [], "path_params": {"name": name}}))


@pytest.mark.parametrize("name", ["map", "report"])
def test_pages_are_served_as_those_of_no_site(recipe, name):
    file = page_file(name)
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text("<p>page</p>")
    answer = asked(name)
    assert answer.status_code == 200
    assert answer.path == file
    policy = answer.headers["content-security-policy"]
    assert policy.startswith("sandbox")
    assert "allow-same-origin" not in policy
    assert answer.headers["cache-control"] == "no-cache"


def test_the_pages_are_those_that_the_commands_write(recipe, tmp_path):
    assert page_file("map") == map_path(recipe)
    written = report_path(recipe)
    assert page_file("report") == written  # with the dataset
    written.parent.mkdir(parents=True, exist_ok=True)
    written.touch()
    by_command = tmp_path / "report.html"
    by_command.touch()
    for newer, older in ((by_command, written), (written, by_command)):
        os.utime(older, (1, 1))
        os.utime(newer, (2, 2))
        assert page_file("report") == newer
    assert (
        page_link("map", Path("/a*b/map.html")) == r'[](/bagassets/pages/map "Open the map") /a\*b/map.html'
    )


@pytest.mark.parametrize(("name", "what"), [("map", "bagassets build"), ("report", "bagassets report")])
def test_a_page_that_was_not_made_says_what_makes_it(recipe, name, what):
    answer = asked(name)
    assert answer.status_code == 404
    assert what in answer.body.decode()


@pytest.mark.parametrize("name", ["recipe.yaml", "../recipe.yaml", "", "map/..", "report.html"])
def test_there_are_no_other_pages(recipe, name):
    assert page_file(name) is None
    assert asked(name).status_code == 404


@pytest.mark.parametrize(
    ("path", "ours"), [("/", True), ("/{path:path}", True), ("/vendor/page.html", False)]
)
def test_long_words_wrap_on_the_pages_of_the_ui_and_nothing_else_changes(path, ours):
    plain = "<html><head><title>Dagster</title></head><body></body></html>"
    headers = {"Content-Security-Policy": "style-src 'unsafe-inline' 'self'"}
    route = Route(path, lambda _: HTMLResponse(plain, headers=headers))
    answer = styled(route).endpoint(None)
    assert answer.headers["content-security-policy"] == headers["Content-Security-Policy"]
    assert int(answer.headers["content-length"]) == len(answer.body)
    assert ("overflow-wrap:anywhere" in answer.body.decode()) == ours
    assert re.sub("<style>.*</style>", "", answer.body.decode(), flags=re.DOTALL) == plain
