"""What a build begins with while its server starts."""

import json
import os
import subprocess
import sys

import pytest

from bagassets.defs.early_inventories import make_inventories
from bagassets.forkserver.client import Client
from bagassets.forkserver.server_files import ServerFiles
from bagassets.recipe import load_recipe
from bagassets.recordings.digest import DigestIndex, recording_digest
from bagassets.recordings.discover import discover
from bagassets_tests.in_process import make_project

pytestmark = pytest.mark.once

KEYS = ["a.bag", "b.mcap", "c"]  # of three formats: equal content would be one action


@pytest.fixture
def project(tmp_path):
    recipe_file = make_project(tmp_path / "project", KEYS, duration_s=1.0)
    yield recipe_file
    for client in Client.all_of(load_recipe(recipe_file).state):
        client.shutdown(grace_s=1.0)


def asked(recipe_file, *bags):
    state = load_recipe(recipe_file).state
    return {"recipe": str(recipe_file), "bags": list(bags), "state": str(state), "stamp": "0" * 64}


def steps_in_store(recipe_file):
    actions = (load_recipe(recipe_file).store_path / "actions").glob("*/*.json")
    return sorted(json.loads(path.read_bytes())["action"]["step"] for path in actions)


def test_inventories_are_made_and_digests_kept(project):
    assert make_inventories(asked(project)) == 3
    assert steps_in_store(project) == ["inventory"] * 3
    recipe = load_recipe(project)
    index = DigestIndex.of(recipe)
    recordings = discover(recipe.bags).recordings.values()
    assert [recording_digest(recording, index).hashed_bytes for recording in recordings] == [0, 0, 0]
    assert [recording_digest(recording).hashed_bytes > 0 for recording in recordings] == [
        True
    ] * 3  # not beside them


def test_those_that_are_asked_for(project):
    assert make_inventories(asked(project, "b.*", "a.bag")) == 2
    assert steps_in_store(project) == ["inventory"] * 2


def test_it_ends_when_the_server_serves(project, monkeypatch):
    states = iter([None, "socket"])
    monkeypatch.setattr(ServerFiles, "socket", property(lambda _self: next(states)))
    assert make_inventories(asked(project)) == 1


def test_a_damaged_recording_costs_the_others_nothing(project):
    damaged = project.parent / "bags" / "a.bag"
    damaged.write_bytes(damaged.read_bytes()[:-5000])
    os.truncate(project.parent / "bags" / "b.mcap", 0)
    assert make_inventories(asked(project)) == 3
    assert steps_in_store(project).count("inventory") >= 1


def test_a_cold_build_counts_what_was_made_ahead_as_built(project):
    command = [sys.executable, "-m", "bagassets", "build", "--recipe", str(project), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    output = json.loads(done.stdout)
    assert output["counts"]["built"] == 3
    [client] = Client.all_of(load_recipe(project).state)
    log = client.files.log.read_text()
    assert "job make_inventories: exit code 0" in log
    assert "bagassets.defs.early_inventories:make_inventories" in log
