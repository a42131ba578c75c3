"""How far a run is with a large recording: in its log, and before the eyes of who builds."""

import io

import dagster as dg
import pytest
from rich.console import Console

from bagassets.cli.progress import LinesProgress, LiveProgress
from bagassets.defs.builds.pending_work import open_project
from bagassets.defs.runs import run_pool
from bagassets.engine import source as engine_source
from bagassets.engine.build_report import Event
from bagassets.engine.source import MessageSource, progress_told
from bagassets.recipe import load_recipe
from bagassets.recordings.digest import recording_stat
from bagassets.recordings.discover import discover
from bagassets_tests.in_process import build, make_project

pytestmark = pytest.mark.once

KEYS = ("a.bag", "b", "c.mcap")
PASSES = ["hash and inventory", "images and clouds"]


@pytest.fixture
def project(tmp_path):
    return make_project(tmp_path, KEYS)


@pytest.fixture
def at_once(monkeypatch):
    """Each read is reported, however fast."""
    monkeypatch.setattr(engine_source, "EVERY_S", 0.0)
    monkeypatch.setattr(run_pool, "_LOG_S", -1.0)


def read_whole(recipe_file, key, tell=None):
    recipe = load_recipe(recipe_file)
    recording = discover(recipe.bags).recordings[key]
    source = MessageSource(recording, recording_stat(recording), (), recipe.limits, what="reading it")
    with progress_told(tell), source.whole() as opened:
        return len(list(opened.messages(list(opened.topics))))


@pytest.mark.parametrize("key", KEYS)
def test_a_pass_tells_how_far_it_is(project, at_once, key):
    told = []
    read_whole(project, key, told.append)
    shares = [one.share for one in told]
    assert shares == sorted(shares)
    assert 0 < shares[0] <= shares[-1] <= 1
    assert shares[-1] > 0.4, "less than the whole only because the last chunk is a large part of it"
    assert {one.what for one in told} == {"reading it"}
    assert all(one.bytes_per_s > 0 for one in told)


def test_what_the_listener_raises_is_no_error_of_the_reading(project, at_once):
    def tell(_reading):
        raise OSError("the database is gone")

    assert read_whole(project, "a.bag", tell) == read_whole(project, "a.bag", [].append)


def readings(instance):
    """Run id -> what its log says of reading."""
    return {
        run.run_id: [
            entry.get_dagster_event().message
            for entry in instance.all_logs(run.run_id, of_type=dg.DagsterEventType.ENGINE_EVENT)
            if any(what in entry.get_dagster_event().message for what in PASSES)
        ]
        for run in instance.get_runs()
        if "dagster/partition" in run.tags
    }


def test_a_long_run_says_what_is_being_done_and_how_far(project, at_once, monkeypatch):
    events = []
    build(project, monkeypatch, on_event=events.append, jobs=1)
    with open_project(project) as workspace:
        instance = workspace.instance
        said = readings(instance)
    for what in PASSES:
        # Recordings with the same images share them: not every run reads them.
        lines = [line for lines in said.values() for line in lines if line.startswith(f"{what}: ")]
        assert lines
        assert all("% of" in line and line.endswith("B/s") for line in lines)
    for key in KEYS:
        seen = [event for event in events if (event.kind, event.key) == ("where", key)]
        assert seen
        assert all(0 < event.share <= 1 and "% of" in event.message for event in seen)


def test_a_short_run_says_nothing_of_it(project, monkeypatch):
    build(project, monkeypatch, jobs=1)
    with open_project(project) as workspace:
        instance = workspace.instance
        assert list(readings(instance).values()) == [[]] * len(KEYS)


def test_a_terminal_shows_a_bar():
    with LiveProgress() as show:
        show(Event("planned", sizes={"a.bag": 10**10}))
        show(Event("started", "a.bag"))
        show(Event("where", "a.bag", "images and clouds: 34% of 10.0 GB, 210.0 MB/s", share=0.34))
        console = Console(file=io.StringIO(), width=120)
        console.print(show.render())
    (line,) = [line for line in console.file.getvalue().splitlines() if "a.bag" in line]
    assert "━━━" in line
    assert line.rstrip().endswith("34% of 10.0 GB, 210.0 MB/s")


def test_a_log_has_a_line(capsys):
    LinesProgress()(Event("where", "a.bag", "images and clouds: 34% of 10.0 GB", share=0.34))
    assert capsys.readouterr().err == "         a.bag: images and clouds: 34% of 10.0 GB\n"
