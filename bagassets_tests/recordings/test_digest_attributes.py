"""What a build writes to recordings: nothing, unless the recipe says so."""

import os
from pathlib import Path

import pytest

from bagassets.defs.builds.made_ahead import make_first
from bagassets.recipe import load_recipe
from bagassets.recordings.digest_record import ATTRIBUTE
from bagassets_tests.in_process import QUICK, build, make_project

pytestmark = pytest.mark.once


@pytest.fixture
def written(monkeypatch):
    """Names of the files that got an attribute."""
    names = []
    monkeypatch.setattr(
        os, "setxattr", lambda path, attribute, _value: names.append((Path(path).name, attribute))
    )
    return names


def ahead(recipe_file, _monkeypatch):
    state = load_recipe(recipe_file).state
    assert make_first(
        {"recipe": str(recipe_file), "bags": [], "select": [], "state": str(state), "stamp": "0" * 64}
    )


@pytest.mark.parametrize("work", [build, ahead])
@pytest.mark.parametrize("wanted", [None, False, True])
def test_attributes_are_written_only_if_the_recipe_says_so(tmp_path, monkeypatch, written, work, wanted):
    text = QUICK
    if wanted is not None:
        text = QUICK.replace("settle_s: 0", f"settle_s: 0, digest_attributes: {str(wanted).lower()}")
    recipe_file = make_project(tmp_path, text=text)
    work(recipe_file, monkeypatch)
    assert set(written) == ({("a.bag", ATTRIBUTE)} if wanted else set())
