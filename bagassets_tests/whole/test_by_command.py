"""What `bagassets build` gives, run as users run it: for the devkit, twice at once, and killed at any moment."""

import json
import os
import random
import subprocess
import sys
import time
from uuid import uuid4

import pytest
from devkit import run_devkit

from bagassets.forkserver.client import Client
from bagassets.formats.dataset_lock import read_lock
from bagassets.recipe import load_recipe
from bagassets.store.store import Store
from bagassets_tests.defs.records.test_databases import kill_all
from bagassets_tests.in_process import make_project
from bagassets_tests.nuscenes_checks import check_dataset
from bagassets_tests.store_check import check_store

pytestmark = [pytest.mark.xdist_group("by_command"), pytest.mark.once]

NAMES, VERSION = ["a.bag", "b", "c.mcap"], "v1.0-test"


def start(recipe_file, mark=None):
    command = [sys.executable, "-m", "bagassets", "build", "--recipe", str(recipe_file), "--json"]
    surroundings = os.environ | ({"BAGASSETS_TEST_MARK": mark} if mark else {})
    return subprocess.Popen(
        command, env=surroundings, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def finish(process):
    out, err = process.communicate(timeout=300)
    assert process.returncode == 0, err
    return json.loads(out)


def everything(recipe):
    """Name -> bytes of the dataset, lock included."""
    folder = recipe.nuscenes.output
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and not path.name.startswith(".bagassets")
    }


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """A project that one undisturbed command built, and how long that took."""
    recipe_file = make_project(tmp_path_factory.mktemp("built"), NAMES, duration_s=2.0)
    begun = time.monotonic()
    reported = finish(start(recipe_file))
    seconds = time.monotonic() - begun
    assert reported["counts"]["built"] == len(NAMES)
    recipe = load_recipe(recipe_file)
    end_servers(recipe)
    return recipe, seconds


@pytest.fixture
def project(tmp_path):
    recipe_file = make_project(tmp_path, NAMES, duration_s=2.0)
    yield recipe_file
    end_servers(load_recipe(recipe_file))


def end_servers(recipe):
    for client in Client.all_of(recipe.state):
        client.shutdown(grace_s=0.0)


@pytest.mark.devkit
def test_the_devkit_loads_and_walks_what_the_command_built(built):
    recipe, _ = built
    assert check_dataset(recipe.nuscenes.output, VERSION) == []
    walked = run_devkit("devkit_walk.py", recipe.nuscenes.output, VERSION)
    counts = [bag.counts for bag in read_lock(recipe.nuscenes.output / VERSION).bags.values()]
    assert walked["tables"]["scene"] == sum(one["scenes"] for one in counts) == len(NAMES)
    assert walked["tables"]["sample"] == sum(one["samples"] for one in counts)
    assert sum(walked["readings"].values()) == walked["tables"]["sample_data"]


def test_two_commands_at_once_build_what_one_builds(built, project):
    reported = [finish(process) for process in [start(project), start(project)]]
    recipe = load_recipe(project)
    for report in reported:
        assert not report["counts"]["failed"], report
        assert report["dataset"]["problem"] == ""
    assert everything(recipe) == everything(built[0])
    assert list(check_store(Store(recipe.store_path))) == []
    assert list((recipe.store_path / "tmp").iterdir()) == []
    assert finish(start(project))["counts"]["fresh"] == len(NAMES)


@pytest.mark.long
@pytest.mark.parametrize("seed", [0, 1])
def test_after_kills_at_any_moment_the_command_builds_the_same(built, project, seed):
    """All processes at once, server and workers as well, as a container's end does."""
    dice, recipe = random.Random(seed), load_recipe(project)
    store, output = Store(recipe.store_path), recipe.nuscenes.output
    for _ in range(3):
        mark = str(uuid4())
        process = start(project, mark)
        time.sleep(dice.random() * built[1])
        kill_all(f"BAGASSETS_TEST_MARK={mark}")
        process.communicate()
        # Nothing half-made is to be seen.
        assert list(check_store(store)) == []
        if output.is_dir() and read_lock(output / VERSION) is not None:
            assert check_dataset(output, VERSION) == []
    finish(start(project))
    assert everything(recipe) == everything(built[0])
    assert list(check_store(store)) == []
