"""The trace of a build is a Chrome trace of bags, steps, workers and processors."""

import json
import os
import threading
from itertools import pairwise

import pytest
from click.testing import CliRunner

from bagassets.base import trace
from bagassets.base.errors import BagAssetsError
from bagassets.cli.main import root
from bagassets.engine.build_report import Event
from bagassets.engine.trace_file import recorded_trace, trace_recordings
from bagassets.forkserver.client import Client
from bagassets.sample.drive import Target, write_recordings
from bagassets.sample.recipe import sample_recipe

pytestmark = pytest.mark.once


def events_of(file):
    content = json.loads(file.read_text())
    assert content["displayTimeUnit"] == "ms"
    return content["traceEvents"]


def record(tmp_path, work):
    with recorded_trace(tmp_path / "trace.json", tmp_path / "state"):
        work()
    return events_of(tmp_path / "trace.json")


def test_spans_nest_and_carry_their_facts(tmp_path):
    def work():
        with trace.span("outer", bag="a.bag"), trace.span("inner"):
            pass

    spans = {event["name"]: event for event in record(tmp_path, work) if event["ph"] == "X"}
    outer, inner = spans["outer"], spans["inner"]
    assert outer["args"] == {"bag": "a.bag"}
    assert outer["ts"] <= inner["ts"]
    assert inner["ts"] + inner["dur"] <= outer["ts"] + outer["dur"] + 1e-3  # rounded to nanoseconds
    assert outer["pid"] == os.getpid()


def test_what_failed_says_so_and_is_raised(tmp_path):
    def work():
        with pytest.raises(BagAssetsError, match="no such thing"), trace.span("step"):
            raise BagAssetsError("no such thing")

    (step,) = [event for event in record(tmp_path, work) if event["name"] == "step"]
    assert step["args"] == {"error": "no such thing"}


def test_threads_and_forked_processes_have_tracks_of_their_own(tmp_path):
    def child():
        trace.name_process("worker: b.bag")
        with trace.span("work"):
            pass

    def work():
        thread = threading.Thread(target=child)
        thread.start()
        thread.join()
        pid = os.fork()
        if pid == 0:
            child()
            os._exit(0)
        os.waitpid(pid, 0)

    events = record(tmp_path, work)
    tracks = {(event["pid"], event["tid"]) for event in events if event["name"] == "work"}
    assert len(tracks) == 2
    assert {pid for pid, _ in tracks} != {os.getpid()}
    named = [event["args"]["name"] for event in events if event["name"] == "process_name"]
    assert named == ["bagassets build", "worker: b.bag", "worker: b.bag"]


def test_without_a_trace_nothing_is_recorded(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with trace.span("nothing"):
        trace_recordings(Event("started", "a.bag"))
    assert list(tmp_path.iterdir()) == []


def test_it_leaves_nothing_but_the_trace_even_if_the_build_fails(tmp_path):
    with (
        pytest.raises(ZeroDivisionError),
        recorded_trace(tmp_path / "trace.json", tmp_path / "state"),
        trace.span("doomed"),
    ):
        raise ZeroDivisionError
    assert list((tmp_path / "state").iterdir()) == []
    assert trace.VARIABLE not in os.environ
    assert "doomed" in {event["name"] for event in events_of(tmp_path / "trace.json")}


def test_a_line_cut_short_by_a_kill_costs_that_line_only(tmp_path):
    def work():
        with trace.span("whole"):
            pass
        (file,) = (tmp_path / "state").glob("trace-*/*.jsonl")
        with file.open("a") as stream:
            stream.write('{"ph": "X", "na')

    names = [event["name"] for event in record(tmp_path, work)]
    assert "whole" in names


def test_a_place_that_cannot_be_written_is_refused_before_the_work(tmp_path):
    began = []
    with (
        pytest.raises(BagAssetsError, match=r"no folder/trace\.json: the trace cannot be written there"),
        recorded_trace(tmp_path / "no folder" / "trace.json", tmp_path),
    ):
        began.append(True)
    assert began == []


def test_a_build_shows_bags_steps_images_and_processors(tmp_path):
    write_recordings([Target(tmp_path / "recordings" / "one.mcap", "mcap")], duration_s=1.2)
    (tmp_path / "recipe.yaml").write_text(sample_recipe().replace("settle_s: 2", "settle_s: 0"))
    command = ["build", "--recipe", str(tmp_path / "recipe.yaml"), "--trace", str(tmp_path / "trace.json")]
    try:
        result = CliRunner().invoke(root, command)
    finally:
        for client in Client.all_of(tmp_path / ".bagassets"):
            client.shutdown()
    assert result.exit_code == 0, result.output
    events = events_of(tmp_path / "trace.json")

    bag, dataset = (
        [event for event in events if event.get("id") == name] for name in ("one.mcap", "dataset")
    )
    assert [(event["ph"], event["args"]) for event in bag] == [("b", {}), ("e", {"result": "done"})]
    assert [event["ph"] for event in dataset] == ["b", "e"]

    spans = [event for event in events if event["ph"] == "X"]
    names = {event["name"] for event in spans}
    steps = {"inventory", "calibration", "ego_poses", "annotations", "frames and sweeps", "nuscenes_tables"}
    assert {"plan", "find or start the server", "run", "hash", "nuscenes_dataset", *steps} <= names
    (run,) = [event for event in spans if event["name"] == "run" and event["pid"] == _worker(events)]
    inside = [event for event in spans if event["pid"] == run["pid"] and event["name"] in steps]
    # What takes long was made while the server started, by another process.
    assert {event["name"] for event in inside} >= steps - {"frames and sweeps"}
    assert all(run["ts"] <= e["ts"] and e["ts"] + e["dur"] <= run["ts"] + run["dur"] for e in inside)
    images = [event["args"]["channel"] for event in spans if event["name"] == "image"]
    assert set(images) == {"CAM_FRONT", "CAM_FRONT_LEFT", "CAM_FRONT_RIGHT"}

    shares = [event["args"] for event in events if event["ph"] == "C"]
    assert shares
    assert all(0 <= share <= 100 for sample in shares for share in sample.values())
    assert all(a["ts"] <= b["ts"] for a, b in pairwise(events))


def _worker(events):
    (pid,) = {
        event["pid"]
        for event in events
        if event["name"] == "process_name" and event["args"]["name"] == "worker: one.mcap"
    }
    return pid
