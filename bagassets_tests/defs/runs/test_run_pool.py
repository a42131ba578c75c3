"""Runs handed to whatever launcher an instance has, and followed to their ends."""

import json
import os
import signal
import threading
import time
from pathlib import Path

import dagster as dg
import pytest
import small_definitions
from dagster._core.launcher import RunLauncher
from dagster._serdes import ConfigurableClass

from bagassets.defs.records.events import Records
from bagassets.defs.records.instances import open_instance
from bagassets.defs.records.naming import Naming
from bagassets.defs.runs.execution import CodeLocation
from bagassets.defs.runs.run_pool import RunPool
from bagassets.defs.runs.worker_tag import RunWorker
from bagassets.forkserver.client import Client

TESTS = Path(__file__).parents[2]
LOCATION = CodeLocation("small_definitions", working_directory=str(TESTS))
WAIT_S = 60


class RefusingLauncher(RunLauncher, ConfigurableClass):
    """A launcher that takes no run of the recording `drive`, and executes none of the others."""

    def __init__(self, inst_data=None):
        self._inst_data = inst_data
        super().__init__()

    @property
    def inst_data(self):
        return self._inst_data

    @classmethod
    def config_type(cls):
        return {}

    @classmethod
    def from_config_value(cls, inst_data, config_value):
        return cls(inst_data)

    def launch_run(self, context):
        run = context.dagster_run
        if run.tags.get("dagster/partition") == "drive":
            raise RuntimeError("sbatch: error: invalid partition specified: gpu")
        self._instance.report_run_failed(run, "The node that was to execute it is down.")

    def terminate(self, run_id):
        return False


def make_home(folder, launcher):
    module, _, name = launcher.rpartition(".")
    config = {"state_folder": str(folder / "state"), "grace_s": 1} if name.startswith("BagAssets") else {}
    (folder / "dagster.yaml").write_text(
        "telemetry: {enabled: false}\n"
        f"run_launcher: {{module: {module}, class: {name}, config: {json.dumps(config)}}}\n",
        "utf-8",
    )
    return str(folder)


@pytest.fixture(
    scope="module",
    params=[
        "bagassets.defs.launchers.launcher.BagAssetsRunLauncher",
        pytest.param("dagster.DefaultRunLauncher", marks=pytest.mark.long),
    ],
)
def home(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("follow")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(TESTS.parent))  # for Dagster's own code server
        yield Path(make_home(folder, request.param))
    for client in Client.all_of(folder / "state"):
        client.shutdown(grace_s=0.0)


@pytest.fixture
def instance(home):
    with open_instance(str(home)) as instance:
        instance.add_dynamic_partitions(small_definitions.recordings.name, ["drive", "walk", "third"])
        yield instance


@pytest.fixture(autouse=True)
def steering(tmp_path, monkeypatch):
    monkeypatch.setenv("SMALL_DEFINITIONS", str(tmp_path))
    return tmp_path


def follow(instance, todo, jobs=2):
    events = []
    log = Path(instance.root_directory) / "code-server.log"
    with RunPool(
        Records(instance, Naming("test")),
        jobs,
        lambda event: events.append((event.kind, event.key)),
        log,
        LOCATION,
    ) as runs:
        runs.work([{key: assets} for key, assets in todo.items()])
    return runs, events


def status_of(instance, run_id):
    return instance.get_run_by_id(run_id).status.value


def test_recordings_are_run_side_by_side_and_failures_are_reported_in_the_librarys_words(instance, steering):
    todo = {"drive": ("first", "second"), "walk": ("broken",), "no such drive": ("first",), "": ("whole",)}
    runs, events = follow(instance, todo)
    assert {key: ended.problem for key, ended in runs.ended.items()} == {
        "drive": None,
        "walk": "drive.bag: the recording is truncated; copy it again.",
        "no such drive": "no such drive: no such partition; it was removed, or never registered.",
        "": None,
    }
    assert not runs.interrupted
    assert not any(ended.stopped for ended in runs.ended.values())
    assert sorted(events) == sorted([
        ("started", "drive"), ("done", "drive"), ("started", "walk"), ("failed", "walk"),
        ("failed", "no such drive"), ("started", ""), ("done", ""),
    ])  # fmt: skip
    assert status_of(instance, runs.ended["drive"].run_id) == "SUCCESS"
    assert status_of(instance, runs.ended["walk"].run_id) == "FAILURE"
    for ended in runs.ended.values():
        if ended.run_id:
            run = instance.get_run_by_id(ended.run_id)
            # What the web UI needs to show its code, and to execute it again.
            assert run.remote_job_origin is not None
            assert run.job_code_origin is not None


def test_no_more_than_jobs_are_begun_at_once(instance, steering):
    todo = dict.fromkeys(("drive", "walk", "third"), ("first",))
    runs, _ = follow(instance, todo, jobs=1)
    assert all(ended.problem is None for ended in runs.ended.values())
    spans = [line.split()[0] for line in (steering / "spans").read_text().splitlines()]
    assert spans == ["begin", "end"] * 3


@pytest.fixture
def interruptible():
    """Shells have what they start in the background ignore Ctrl-C."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


class Interrupting:
    """Interrupts this process in a finalizer, where Python prints what is raised and goes on."""

    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)


@pytest.mark.usefixtures("interruptible")
def test_an_interrupt_is_not_lost_where_exceptions_are_ignored(instance, steering):
    def interrupt(event):
        if event.kind == "started":
            Interrupting()

    (steering / "hold").touch()
    with RunPool(
        Records(instance, Naming("test")), 1, interrupt, steering / "code-server.log", LOCATION
    ) as runs:
        threading.Timer(30, (steering / "hold").unlink, [True]).start()  # or a lost interrupt would never end
        runs.work([{"drive": ("first",)}])
    assert runs.interrupted
    assert runs.ended["drive"].stopped


@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize("when", ["starting", "at work"])
def test_an_interrupt_cancels_what_was_begun(instance, steering, when):
    def is_time():
        if when == "at work":
            return (steering / "spans").exists()
        return bool(instance.get_runs(dg.RunsFilter(statuses=[dg.DagsterRunStatus.STARTING])))

    def interrupt():
        deadline = time.monotonic() + WAIT_S
        while not is_time() and time.monotonic() < deadline:
            time.sleep(0.01)
        os.kill(os.getpid(), signal.SIGINT)

    (steering / "hold").touch()
    thread = threading.Thread(target=interrupt)
    thread.start()
    runs, events = follow(instance, {"drive": ("first",), "walk": ("first",)}, jobs=1)
    thread.join()
    assert runs.interrupted
    assert runs.ended["drive"].stopped
    assert runs.ended["walk"].stopped
    assert runs.ended["walk"].run_id == "", "it was never begun"
    assert events == [("started", "drive"), ("stopped", "drive")]
    assert status_of(instance, runs.ended["drive"].run_id) == "CANCELED"


def test_a_killed_worker_fails_its_run_only(instance, steering):
    def kill():
        deadline = time.monotonic() + WAIT_S
        while not (steering / "attempts").exists() and time.monotonic() < deadline:
            time.sleep(0.05)
        (record,) = instance.get_run_records(dg.RunsFilter(statuses=[dg.DagsterRunStatus.STARTED]))
        run = record.dagster_run
        worker = RunWorker.of(run)
        if worker is not None:
            assert worker.process.send(signal.SIGKILL)
            return
        (started,) = [
            entry.get_dagster_event().engine_event_data.metadata["pid"].value
            for entry in instance.all_logs(run.run_id, of_type=dg.DagsterEventType.ENGINE_EVENT)
            if "Started process for run" in (entry.get_dagster_event().message or "")
        ]
        os.kill(int(started), signal.SIGKILL)

    thread = threading.Thread(target=kill)
    thread.start()
    runs, _ = follow(instance, {"drive": ("patient",), "walk": ("first",)}, jobs=1)
    thread.join()
    assert "SIGKILL" in runs.ended["drive"].problem or "unexpectedly exited" in runs.ended["drive"].problem
    assert runs.ended["walk"].problem is None
    assert status_of(instance, runs.ended["drive"].run_id) == "FAILURE"


def test_what_a_launcher_has_to_say_is_the_reason_of_the_failure(tmp_path):
    launcher = f"{RefusingLauncher.__module__}.{RefusingLauncher.__name__}"
    with open_instance(make_home(tmp_path, launcher)) as instance:
        instance.add_dynamic_partitions(small_definitions.recordings.name, ["drive", "walk"])
        runs, events = follow(instance, {"drive": ("first",), "walk": ("first",)})
        assert runs.ended["drive"].problem == (
            "its run could not be launched: sbatch: error: invalid partition specified: gpu"
        )
        assert runs.ended["walk"].problem == "The node that was to execute it is down."
        assert ("failed", "drive") in events
        assert {status_of(instance, ended.run_id) for ended in runs.ended.values()} == {"FAILURE"}


@pytest.mark.parametrize(("age_s", "late_s"), [(0.1, 0.03), (5.0, 0.15), (3600.0, 0.5)])
def test_the_end_of_a_run_is_noticed_late_by_a_share_of_its_duration(tmp_path, monkeypatch, age_s, late_s):
    make_home(tmp_path, "dagster.DefaultRunLauncher")
    slept, now = [], time.monotonic()
    with open_instance(str(tmp_path)) as instance:
        pool = RunPool(Records(instance, Naming("")), 1, lambda _: None, tmp_path / "log", LOCATION)
        pool._take_over("run", ["drive"])
        pool._active["run"].since = now - age_s
        monkeypatch.setattr(time, "sleep", slept.append)
        monkeypatch.setattr(time, "monotonic", lambda: now)
        pool._poll()
        monkeypatch.undo()
    assert slept == [pytest.approx(late_s)]
