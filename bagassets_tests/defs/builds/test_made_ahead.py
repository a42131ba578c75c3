"""What a build begins with while its server starts, and while it plans."""

import json
import os
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest
import yaml
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from bagassets.defs.builds import made_ahead
from bagassets.defs.builds.made_ahead import make_ahead, make_first, make_new, making_ahead
from bagassets.defs.runs.launching import executes_here
from bagassets.engine.build_report import BuildOptions
from bagassets.engine.execute import execute
from bagassets.engine.first_pass import first_pass, only_reader, reading_left, was_just_made
from bagassets.engine.source import Progress, progress_told, tell_progress
from bagassets.forkserver.client import Client
from bagassets.forkserver.server_files import ServerFiles
from bagassets.formats.after_crash import noted_build
from bagassets.formats.catalogue import recording_assets
from bagassets.formats.trajectory_map import SHELL, map_shell_of
from bagassets.recipe import load_recipe
from bagassets.recordings.digest import recording_digest, recording_stat
from bagassets.recordings.digest_record import DigestIndex
from bagassets.recordings.discover import discover
from bagassets.report.map_shell import map_shell
from bagassets.store import lease
from bagassets.store.store import Store
from bagassets_tests.in_process import build, make_project
from bagassets_tests.services import eventually

pytestmark = pytest.mark.once

KEYS = ["a.bag", "b.mcap", "c"]  # of three formats: equal content would be one action


@pytest.fixture
def project(tmp_path):
    recipe_file = make_project(tmp_path / "project", KEYS, duration_s=1.0)
    yield recipe_file
    for client in Client.all_of(load_recipe(recipe_file).state):
        client.shutdown(grace_s=1.0)


def asked(recipe_file, *bags, select=()):
    state = load_recipe(recipe_file).state
    asked = {"recipe": str(recipe_file), "bags": list(bags), "select": list(select)}
    return {**asked, "state": str(state), "stamp": "0" * 64}


def actions_in_store(recipe_file):
    actions = (load_recipe(recipe_file).store_path / "actions").glob("*/*.json")
    return {path.stem: json.loads(path.read_bytes())["action"]["step"] for path in actions}


def steps_in_store(recipe_file):
    return sorted(actions_in_store(recipe_file).values())


def test_how_far_killed_processes_had_read_is_forgotten_by_the_next_build(tmp_path):
    recipe_file = make_project(tmp_path, [])
    recipe = load_recipe(recipe_file)
    ahead = recipe.state / "ahead"
    ahead.mkdir(parents=True)
    for name in ("killed.reading", "living.reading", "1f"):
        (ahead / name).write_text("{}")
    for name in ("killed.reading", "1f"):
        os.utime(ahead / name, (time.time() - 3600,) * 2)
    with noted_build(recipe, recipe_file):
        left = {path.name for path in ahead.iterdir()}
    assert left == {"living.reading", "1f"}, "a note of what was made is for its run"


def test_all_of_the_recordings_is_made_as_a_run_would_make_it(project, monkeypatch):
    assert make_first(asked(project)) == 3
    made = actions_in_store(project)
    assert sorted(made.values()).count("nuscenes_tables") == 3
    recipe = load_recipe(project)
    index = DigestIndex.of(recipe)
    recordings = discover(recipe.bags).recordings.values()
    assert [recording_digest(recording, index).hashed_bytes for recording in recordings] == [0, 0, 0]
    assert [recording_digest(recording).hashed_bytes > 0 for recording in recordings] == [
        True
    ] * 3  # not beside them
    events = []
    report, _ = build(project, monkeypatch, on_event=events.append)
    later = [actions_in_store(project)[action] for action in actions_in_store(project).keys() - made]
    assert not later, "but for the datasets, nothing was left to the runs"
    assert report.counts()["built"] == 3, "it was made for them"
    assert not any(was_just_made(recipe.state, action) for action in made), "that is told once"
    ended = {event.key: event.message for event in events if event.kind == "done"}
    assert ended == {**dict.fromkeys(KEYS, "made ahead"), "": ""}, "the time of their runs is not all"
    assert build(project, monkeypatch, retry_failed=True)[0].counts()["fresh"] == 3


def test_what_was_made_is_known_of_a_recording_that_had_been_hashed(project):
    recipe = load_recipe(project)
    recording_digest(discover(recipe.bags).recordings["a.bag"], DigestIndex.of(recipe))
    assert make_first(asked(project, "a.bag")) == 1
    made = actions_in_store(project)
    for action in made:
        was_just_made(recipe.state, action)
    assert make_first(asked(project, "a.bag")) == 1
    assert actions_in_store(project) == made
    assert not any(was_just_made(recipe.state, action) for action in made)  # the store had it


def test_of_a_recording_whose_inventory_is_known_nothing_is_tried_again(project):
    assert make_first(asked(project, "a.bag", select=["inventory"])) == 1
    assert make_first(asked(project, "a.bag")) == 1
    assert steps_in_store(project) == ["inventory"]


def test_those_that_are_asked_for(project):
    assert make_first(asked(project, "b.*", "a.bag")) == 2
    assert steps_in_store(project).count("inventory") == 2


@pytest.mark.parametrize("why", ["selected", "launcher", "large"])
def test_inventories_alone_where_not_all_is_asked_for_or_others_make_it(project, monkeypatch, why):
    if why == "launcher":
        file = project.with_name("dagster.yaml")
        file.write_text(yaml.safe_dump(yaml.safe_load(file.read_text()) | {"run_launcher": None}))
    if why == "large":
        monkeypatch.setattr(made_ahead, "_LARGEST_WHOLE_BYTES", 1)
    assert make_first(asked(project, select=["frames"] if why == "selected" else [])) == 3
    assert steps_in_store(project) == ["inventory"] * 3


def test_it_ends_when_the_server_serves(project, monkeypatch):
    states = iter([None, "socket"])
    monkeypatch.setattr(ServerFiles, "socket", property(lambda _self: next(states)))
    assert make_first(asked(project)) == 1


def test_a_damaged_recording_costs_the_others_nothing(project):
    damaged = project.parent / "bags" / "a.bag"
    damaged.write_bytes(damaged.read_bytes()[:-5000])
    os.truncate(project.parent / "bags" / "b.mcap", 0)
    assert make_first(asked(project)) == 3
    assert steps_in_store(project).count("nuscenes_tables") >= 1


def test_a_run_waits_for_what_is_being_made_of_its_recording(project, monkeypatch):
    recipe = load_recipe(project)
    recording = discover(recipe.bags).recordings["a.bag"]
    began, may_go_on = threading.Event(), threading.Event()

    def held_up(graph):
        began.set()
        assert may_go_on.wait(30)
        return execute(graph)

    monkeypatch.setattr(made_ahead, "execute", held_up)
    asked_for = recording_assets(recipe), recording, recording_stat(recording)
    with ThreadPoolExecutor() as pool:
        ahead = pool.submit(make_first, asked(project, "a.bag"))
        assert began.wait(30)
        run = pool.submit(first_pass, *asked_for)
        time.sleep(0.1)
        assert not run.done()
        may_go_on.set()
        assert run.result(30).inventory is None
        assert ahead.result(30) == 1


def test_a_run_that_waits_tells_how_far_the_other_process_is(project, monkeypatch):
    monkeypatch.setattr(lease, "_LOOK_S", 0.0)
    recipe = load_recipe(project)
    assets, recording = recording_assets(recipe), discover(recipe.bags).recordings["a.bag"]
    stat, is_told, told = recording_stat(recording), threading.Event(), []
    reading = Progress("hash and inventory", 0.25, recording.size, 1e6)

    def tell(progress):
        told.append(progress)
        is_told.set()

    def wait():
        with progress_told(tell):
            return first_pass(assets, recording, stat)

    with ThreadPoolExecutor() as pool:
        with only_reader(assets.store, recording, stat), reading_left(recipe.state, recording):
            waiting = pool.submit(wait)
            tell_progress(reading)
            assert is_told.wait(60)
        assert waiting.result().digest.hashed_bytes == recording.size
    assert told == [reading], "each report once"
    assert not list((recipe.state / "ahead").glob("*.reading"))


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


def test_the_server_makes_what_is_new_and_then_what_changed(project):
    assert build_by_command(project)["counts"]["built"] == 3, "what was made ahead counts as built"
    [client] = Client.all_of(load_recipe(project).state)
    with client:
        # The build may be over before its process has ended.
        log = eventually(
            lambda: "job make_first: exit code" in (text := client.files.log.read_text()) and text, "it ends"
        )
    assert "job make_first: exit code 0" in log
    assert "bagassets.defs.builds.made_ahead:make_first" in log
    pack_again(project.parent / "bags" / "b.mcap")
    before = steps_in_store(project)
    deadline = time.monotonic() + 30
    with making_ahead(project, BuildOptions(jobs=2)):
        while len(steps_in_store(project)) == len(before) and time.monotonic() < deadline:
            time.sleep(0.02)
    assert steps_in_store(project).count("inventory") == before.count("inventory") + 1


@pytest.mark.parametrize(
    "options", [BuildOptions(jobs=1), BuildOptions(jobs=2, select=("bag",))], ids=["one job", "assets"]
)
def test_nothing_is_made_ahead_where_that_would_delay_or_is_not_asked_for(project, monkeypatch, options):
    monkeypatch.setattr(made_ahead, "find_server", pytest.fail)
    with making_ahead(project, options):
        assert steps_in_store(project) == []


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
    assert executes_here(lambda: file.parent)
    assert made_ahead._has_our_launcher(project, load_recipe(project))
    ours = yaml.safe_dump(found["run_launcher"], default_flow_style=True)
    file.write_text(yaml.safe_dump(found | {"run_launcher": launcher}) + f"# was: {ours}")
    assert not made_ahead._has_our_launcher(project, load_recipe(project))
    assert not executes_here(lambda: file.parent)
    monkeypatch.setattr(made_ahead, "find_server", pytest.fail)
    with making_ahead(project, BuildOptions(jobs=2)):
        assert steps_in_store(project) == []


def test_without_a_server_nothing_is_made_ahead(project):
    with making_ahead(project, BuildOptions(jobs=2)):
        assert steps_in_store(project) == []


def test_what_has_been_hashed_or_is_large_is_left_alone(project, monkeypatch):
    make_first(asked(project, "a.bag", select=["inventory"]))
    recordings = discover(load_recipe(project).bags).recordings
    large = max(recordings["b.mcap"].size, recordings["c"].size)
    monkeypatch.setattr(made_ahead, "_LARGEST_WHOLE_BYTES", large - 1)
    make_new(load_recipe(project), [])
    steps = steps_in_store(project)
    assert (steps.count("inventory"), steps.count("nuscenes_tables")) == (2, 1)


def test_the_page_of_the_map_is_the_same_without_pandas(project):
    project.write_text(project.read_text().replace("preview: {enabled: false}", "preview: {}"))
    code = """
import sys
from bagassets.defs.builds.made_ahead import make_ahead
make_ahead({"recipe": sys.argv[1], "bags": ["a.bag"]})
assert "folium" in sys.modules and sys.modules["pandas"] is None
"""
    subprocess.run([sys.executable, "-c", code, str(project)], check=True)
    made = map_shell_of(Store(load_recipe(project).store_path)).path(SHELL).read_text("utf-8")
    assert made == map_shell()


def test_none_is_begun_once_the_runs_begin(project, monkeypatch):
    monkeypatch.setattr(made_ahead, "_BEGIN_S", -1.0)
    make_new(load_recipe(project), [])
    assert steps_in_store(project) == []


@pytest.mark.parametrize(
    ("preview", "has_map"),
    [("{}", True), ("{enabled: false}", False), ("{trajectory_map: false}", False)],
)
def test_the_page_of_the_map_is_made_when_a_processor_is_idle(project, monkeypatch, preview, has_map):
    project.write_text(project.read_text().replace("preview: {enabled: false}", f"preview: {preview}"))
    niceness = []
    monkeypatch.setattr(os, "nice", niceness.append)
    monkeypatch.setitem(sys.modules, "pandas", None)  # as this process is none of its own
    make_ahead({"recipe": str(project), "bags": ["a.bag"]})
    assert niceness == [19]
    made = steps_in_store(project)
    assert made.count("map_shell") == int(has_map)
    assert made.count("nuscenes_tables") == 1
    make_ahead({"recipe": str(project), "bags": ["a.bag"]})
    assert steps_in_store(project) == made
