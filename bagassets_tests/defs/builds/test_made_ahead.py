"""What a build begins with while its server starts, and while it plans."""

import json
import os
import subprocess
import sys
import time
from contextlib import contextmanager

import pytest
import yaml
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from bagassets.defs.builds import made_ahead, project_build
from bagassets.defs.builds.made_ahead import (
    make_ahead,
    make_first_inventories,
    make_inventories,
    making_ahead,
)
from bagassets.engine.build_report import BuildOptions
from bagassets.forkserver.client import Client
from bagassets.forkserver.server_files import ServerFiles
from bagassets.recipe import load_recipe
from bagassets.recordings.digest import DigestIndex, recording_digest
from bagassets.recordings.discover import discover
from bagassets_tests.in_process import build, make_project

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


def test_what_was_made_is_known_of_a_recording_that_had_been_hashed(project):
    recipe = load_recipe(project)
    recording = discover(recipe.bags).recordings["a.bag"]
    digest = recording_digest(recording, DigestIndex.of(recipe)).digest
    assert made_ahead._make_inventory(recipe, recording) == digest
    assert steps_in_store(project) == ["inventory"]
    assert made_ahead._make_inventory(recipe, recording) is None  # the store had it


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
    assert "bagassets.defs.builds.made_ahead:make_inventories" in log


# --- while a build plans ------------------------------------------------------------------


def build_by_command(recipe_file):
    command = [sys.executable, "-m", "bagassets", "build", "--recipe", str(recipe_file), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def pack_again(path, library="another"):
    """Write an MCAP anew, so that its bytes differ, and nothing that a topic says."""
    with path.open("rb") as file:
        found = list(make_reader(file).iter_messages())
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE)
        writer.start("ros2", library)
        channels = {}
        for schema, channel, message in found:
            if channel.topic not in channels:
                known = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.topic] = writer.register_channel(
                    channel.topic, channel.message_encoding, known
                )
            writer.add_message(channels[channel.topic], message.log_time, message.data, message.publish_time)
        writer.finish()


def test_the_server_makes_inventories_of_what_changed(project):
    assert build_by_command(project)["counts"]["built"] == 3
    pack_again(project.parent / "bags" / "b.mcap")
    before = steps_in_store(project).count("inventory")
    deadline = time.monotonic() + 30
    with making_ahead(project, BuildOptions(jobs=2)) as made:
        while not made() and time.monotonic() < deadline:
            time.sleep(0.02)
        assert made().keys() == {"b.mcap"}
    assert steps_in_store(project).count("inventory") == before + 1
    after = build_by_command(project)
    assert after["counts"]["hit"] == 1, "it was there when the build began"


@pytest.mark.parametrize(
    "options", [BuildOptions(jobs=1), BuildOptions(jobs=2, select=("bag",))], ids=["one job", "assets"]
)
def test_nothing_is_made_ahead_where_that_would_delay_or_is_not_asked_for(project, monkeypatch, options):
    monkeypatch.setattr(made_ahead, "find_server", pytest.fail)
    with making_ahead(project, options) as made:
        assert made() == {}


@pytest.mark.parametrize(
    "launcher",
    [
        {"module": "bagassets.defs.slurm.launcher", "class": "SlurmRunLauncher"},
        {"module": "dagster", "class": "DefaultRunLauncher"},
        None,
    ],
)
def test_nothing_is_made_ahead_where_others_execute_the_runs(project, monkeypatch, launcher):
    file = project.with_name("dagster.yaml")
    found = yaml.safe_load(file.read_text())
    assert made_ahead._executes_runs_here(project)
    file.write_text(yaml.safe_dump(found | {"run_launcher": launcher}))
    assert not made_ahead._executes_runs_here(project)
    monkeypatch.setattr(made_ahead, "find_server", pytest.fail)
    with making_ahead(project, BuildOptions(jobs=2)) as made:
        assert made() == {}


def test_without_a_server_nothing_is_made_ahead(project):
    with making_ahead(project, BuildOptions(jobs=2)) as made:
        assert made() == {}


def test_what_has_been_hashed_or_is_large_is_left_alone(project, monkeypatch):
    make_inventories(asked(project, "a.bag"))
    recordings = discover(load_recipe(project).bags).recordings
    small, large = sorted(("b.mcap", "c"), key=lambda key: recordings[key].size)
    monkeypatch.setattr(made_ahead, "_LARGEST_WHILE_PLANNED_BYTES", recordings[large].size - 1)
    made = []
    monkeypatch.setattr(made_ahead, "note", made.append)
    make_first_inventories(load_recipe(project), [])
    assert [one.keys() for one in made] == [{small}]
    assert steps_in_store(project) == ["inventory"] * 2


def test_none_is_begun_once_the_runs_begin(project, monkeypatch):
    monkeypatch.setattr(made_ahead, "_BEGIN_S", -1.0)
    make_first_inventories(load_recipe(project), [])
    assert steps_in_store(project) == []


@pytest.mark.parametrize(
    ("preview", "has_map"),
    [("{}", True), ("{enabled: false}", False), ("{trajectory_map: false}", False)],
)
def test_the_page_of_the_map_is_made_when_a_processor_is_idle(project, monkeypatch, preview, has_map):
    project.write_text(project.read_text().replace("preview: {enabled: false}", f"preview: {preview}"))
    niceness = []
    monkeypatch.setattr(os, "nice", niceness.append)
    make_ahead({"recipe": str(project), "bags": ["a.bag"]})
    assert niceness == [19]
    made = ["inventory", *(["map_shell"] if has_map else [])]
    assert sorted(steps_in_store(project)) == made
    make_ahead({"recipe": str(project), "bags": ["a.bag"]})
    assert sorted(steps_in_store(project)) == made


def test_what_was_made_ahead_counts_as_built(project, monkeypatch):
    """Even if it is all that there was to make."""
    assert build(project, monkeypatch)[0].counts()["built"] == 3

    for is_told, outcome in ((True, "built"), (False, "hit")):

        @contextmanager
        def ahead(*_, is_told=is_told):
            made = {}
            with monkeypatch.context() as patch:
                patch.setattr(made_ahead, "note", made.update)
                make_first_inventories(load_recipe(project), [])
            assert made.keys() == {"b.mcap"}
            yield lambda: made if is_told else {}

        pack_again(project.parent / "bags" / "b.mcap", f"for {outcome}")
        monkeypatch.setattr(project_build, "making_ahead", ahead)
        report, _ = build(project, monkeypatch)
        assert report.outcomes["b.mcap"].result == outcome
