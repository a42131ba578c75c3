"""A code location where there is no recipe yet, as in a checkout before `make demo`: it loads, and says what to do."""

import subprocess
import sys
from importlib import import_module

import pytest

from bagassets.base.errors import RecipeError
from bagassets_tests.services import BIN, bare_environment
from bagassets_tests.small_drive import RECIPE

pytestmark = pytest.mark.once


@pytest.fixture
def location(tmp_path, monkeypatch):
    """Return what loads the code location in an empty folder, as a code server does: asset -> its description."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("BAGASSETS_RECIPE", raising=False)

    def load():
        monkeypatch.delitem(sys.modules, "bagassets.definitions", raising=False)
        specs = import_module("bagassets.definitions").defs.resolve_all_asset_specs()
        return {spec.key.to_user_string(): spec.description for spec in specs}

    yield load
    sys.modules.pop("bagassets.definitions", None)


def test_dagster_loads_it_and_says_what_to_do(tmp_path):
    done = subprocess.run(
        [str(BIN / "dagster"), "asset", "list", "-m", "bagassets.definitions"],
        check=False,
        cwd=tmp_path,
        env=bare_environment(),
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert (done.returncode, done.stdout) == (0, "")
    assert "Traceback" not in done.stderr
    sentence = done.stderr.strip().splitlines()[-1]
    assert sentence.startswith("No recipe yet: run `bagassets init PROJECT --bags FOLDER`")
    assert sentence.endswith(f"{tmp_path} has no recipe.yaml or build/demo/recipe.yaml.")


def test_the_web_ui_has_an_asset_that_says_it_until_there_is_a_recipe(tmp_path, location):
    ((name, description),) = location().items()
    assert name == "no_recipe_yet"
    assert description.startswith("No recipe yet: run `bagassets init")
    (tmp_path / "build" / "demo").mkdir(parents=True)
    (tmp_path / "build" / "demo" / "recipe.yaml").write_text(RECIPE.format(name="demo", root="."))
    assets = location()  # a reload
    assert "nuscenes_dataset" in assets
    assert "no_recipe_yet" not in assets


def test_a_recipe_that_is_named_must_be_there(tmp_path, location, monkeypatch):
    monkeypatch.setenv("BAGASSETS_RECIPE", str(tmp_path / "recipe.yaml"))
    with pytest.raises(RecipeError, match=r"recipe\.yaml: no recipe here"):
        location()
