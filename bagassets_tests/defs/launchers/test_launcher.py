"""The run launcher: real instance, real processes, the web UI's own mutations."""

import datetime as dt
import json
import signal
import socket
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from uuid import uuid4

import pytest
import small_definitions
from dagster._core.events import DagsterEvent, DagsterEventType
from dagster._core.launcher import WorkerStatus
from dagster._core.storage.tags import GRPC_INFO_TAG
from dagster._core.workspace.context import WorkspaceProcessContext
from dagster._core.workspace.load_target import ModuleTarget
from dagster._daemon.run_coordinator.queued_run_coordinator_daemon import QueuedRunCoordinatorDaemon
from dagster_graphql.test.utils import execute_dagster_graphql

from bagassets.defs.launchers.launcher import BagAssetsRunLauncher
from bagassets.defs.records.events import Records
from bagassets.defs.records.instances import open_instance
from bagassets.defs.records.naming import Naming
from bagassets.defs.runs.execution import CodeLocation, create_run
from bagassets.defs.runs.orphaned_runs import UNTAKEN_S, end_orphaned_runs
from bagassets.defs.runs.run_pool import RunPool
from bagassets.defs.runs.worker_tag import WORKER_TAG, RunWorker
from bagassets.forkserver.client import Client
from bagassets.forkserver.process import ProcessId
from bagassets.forkserver.tasks import connect, server_spec, submit_run

TESTS = Path(__file__).parents[2]
LOCATION = CodeLocation("small_definitions", working_directory=str(TESTS))
SELECTOR = {
    "repositoryLocationName": "small_definitions",
    "repositoryName": "__repository__",
    "pipelineName": "__ASSET_JOB",
}
WAIT_S = 60
LAUNCH = """
mutation Launch($params: ExecutionParams!) {
  launchRun(executionParams: $params) {
    __typename ... on LaunchRunSuccess { run { runId } } ... on PythonError { message }
  }
}
"""
EXECUTE_AGAIN = """
mutation Again($params: ReexecutionParams!) {
  launchRunReexecution(reexecutionParams: $params) {
    __typename ... on LaunchRunSuccess { run { runId } } ... on PythonError { message }
  }
}
"""
TERMINATE = """
mutation Terminate($run: String!, $policy: TerminateRunPolicy) {
  terminateRun(runId: $run, terminatePolicy: $policy) { __typename ... on TerminateRunFailure { message } }
}
"""


def eventually(condition, what="it happens"):
    deadline = time.monotonic() + WAIT_S
    while not (found := condition()):
        assert time.monotonic() < deadline, f"waited {WAIT_S} s until {what}"
        time.sleep(0.02)
    return found


# --- one instance with a web server's workspace ------------------------------------------


def make_home(folder, coordinator="DefaultRunCoordinator"):
    folder.mkdir()
    config = {"state_folder": str(folder.parent / "state"), "grace_s": 1}
    (folder / "dagster.yaml").write_text(
        f"telemetry: {{enabled: false}}\n"
        f"run_coordinator: {{module: dagster._core.run_coordinator, class: {coordinator}}}\n"
        f"run_launcher:\n"
        f"  module: bagassets.defs.launcher\n"
        f"  class: BagAssetsRunLauncher\n"
        f"  config: {json.dumps(config)}\n",
        "utf-8",
    )
    return str(folder)


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    folder = tmp_path_factory.mktemp("launcher")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(TESTS.parent))  # for Dagster's own code server
        yield folder
    for client in Client.all_of(folder / "state"):
        client.shutdown(grace_s=0.0)


@pytest.fixture(scope="module")
def workspace(place):
    target = ModuleTarget(
        module_name="small_definitions", attribute=None, working_directory=str(TESTS), location_name=None
    )
    with open_instance(make_home(place / "home")) as instance:
        instance.add_dynamic_partitions(small_definitions.recordings.name, ["drive", "walk"])
        with WorkspaceProcessContext(instance, target) as workspace:
            yield workspace


@pytest.fixture
def instance(workspace):
    return workspace.instance


@pytest.fixture(autouse=True)
def steering(tmp_path, monkeypatch):
    monkeypatch.setenv("SMALL_DEFINITIONS", str(tmp_path))
    return tmp_path


def mutate(workspace, mutation, **variables):
    answer = execute_dagster_graphql(workspace.create_request_context(), mutation, variables)
    (found,) = answer.data.values()
    return found


def click(workspace, *assets, key="drive"):
    """Materialize assets as the web UI does; return the run's id."""
    params = {
        "selector": {**SELECTOR, "assetSelection": [{"path": [asset]} for asset in assets]},
        "executionMetadata": {"tags": [{"key": "dagster/partition", "value": key}] if key else []},
    }
    found = mutate(workspace, LAUNCH, params=params)
    assert found["__typename"] == "LaunchRunSuccess", found
    return found["run"]["runId"]


def status_of(instance, run_id):
    return instance.get_run_by_id(run_id).status.value


def ended(instance, run_id):
    eventually(lambda: instance.get_run_by_id(run_id).is_finished, f"run {run_id} ends")
    return status_of(instance, run_id)


def messages(instance, run_id):
    return "\n".join(
        entry.dagster_event.message or "" for entry in instance.all_logs(run_id) if entry.dagster_event
    )


def worker_of(instance, run_id):
    """The worker of a run, once its process id is known."""

    def found():
        worker = RunWorker.of(instance.get_run_by_id(run_id))
        return worker if worker is not None and worker.process is not None else None

    return eventually(found, "the worker is known")


def wait_for_attempt(steering):
    eventually((steering / "attempts").exists, "the step runs")


def terminate_elsewhere(home, run_id):
    """Cancel a run from a process that did not launch it, as the web server does for the daemon's runs."""
    code = (
        "import sys\n"
        "from bagassets.defs.records.instances import open_instance\n"
        "with open_instance(sys.argv[1]) as instance:\n"
        "    print(instance.run_coordinator.cancel_run(sys.argv[2]))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, home, run_id],
        cwd=TESTS.parent,
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.split()[-1] == "True"


# --- launching ---------------------------------------------------------------------------


def test_a_click_runs_in_a_worker_of_the_fork_server(workspace, instance, place):
    run_id = click(workspace, "first", "second")
    assert ended(instance, run_id) == "SUCCESS"
    worker = worker_of(instance, run_id)
    (server,) = [client.process for client in Client.all_of(place / "state")]
    assert worker.server == server
    assert worker.process.pid != server.pid
    assert (place / "state" / "forkserver" / "logs" / f"{run_id}.log").exists()
    if Path("/proc").exists():
        files = [str(file.resolve()) for file in Path(f"/proc/{server.pid}/fd").glob("*")]
        assert not [file for file in files if ".db" in file], "the server keeps no database open"


def test_a_worker_imports_nothing_of_dagster_or_sqlalchemy_again(workspace, instance, steering):
    """What is imported after the fork is paid by every run."""
    spec = server_spec(
        steering / "state", None, modules=("small_definitions", "late_imports"), paths=(str(TESTS),)
    )
    with Client.ensure(spec) as client:
        run_id = create_run(instance, ["first", "second"], partition_key="walk", location=LOCATION)
        args = {"instance": instance.root_directory, "run_id": run_id}
        client.submit("late_imports:of_a_run", args, label="imports")
        late = client.wait(WAIT_S)["result"]
        client.shutdown()
    heavy = [name for name in late if name.startswith(("dagster", "sqlalchemy", "alembic", "upath"))]
    assert heavy == []


def test_executing_a_run_again_works_and_takes_a_worker_of_its_own(workspace, instance):
    first = click(workspace, "whole", key=None)
    assert ended(instance, first) == "SUCCESS"
    params = {"parentRunId": first, "strategy": "ALL_STEPS"}
    again = mutate(workspace, EXECUTE_AGAIN, params=params)["run"]["runId"]
    assert ended(instance, again) == "SUCCESS"
    assert instance.get_run_by_id(again).parent_run_id == first
    assert worker_of(instance, again).process != worker_of(instance, first).process


def test_a_tag_copied_from_the_parent_means_nothing(instance):
    run_id = create_run(instance, ["whole"], location=LOCATION)
    sleeper = subprocess.Popen(["sleep", "600"])
    parents = RunWorker("the parent", ProcessId.current(), ProcessId.of(sleeper.pid))
    instance.add_run_tags(run_id, parents.tags())
    run = instance.get_run_by_id(run_id)
    assert RunWorker.of(run) is None
    assert instance.run_launcher.check_run_worker_health(run).status == WorkerStatus.RUNNING
    assert not instance.run_launcher.terminate(run_id)
    assert status_of(instance, run_id) == "NOT_STARTED"
    assert sleeper.poll() is None
    sleeper.kill()
    sleeper.wait()
    instance.report_run_canceled(run)


def test_a_run_of_the_build_can_be_executed_again_in_the_web_ui(workspace, instance, place):
    with RunPool(
        Records(instance, Naming("test")), 1, lambda _event: None, place / "code-server.log", LOCATION
    ) as runs:
        runs.work([{"": ("whole",)}])
    assert runs.ended[""].problem is None
    run_id = runs.ended[""].run_id
    params = {"parentRunId": run_id, "strategy": "ALL_STEPS"}
    again = mutate(workspace, EXECUTE_AGAIN, params=params)
    assert again["__typename"] == "LaunchRunSuccess", again
    assert ended(instance, again["run"]["runId"]) == "SUCCESS"


def test_the_daemons_queue_launches_too(place, workspace):
    with (
        open_instance(make_home(place / "queue", "QueuedRunCoordinator")) as instance,
        WorkspaceProcessContext(instance, workspace._workspace_load_target) as queueing,
    ):
        run_id = click(queueing, "whole", key=None)
        assert status_of(instance, run_id) == "QUEUED"
        daemon = QueuedRunCoordinatorDaemon(interval_seconds=1)
        assert list(daemon.run_iteration(queueing)) is not None
        assert ended(instance, run_id) == "SUCCESS"
        assert worker_of(instance, run_id)


def test_without_a_server_dagsters_own_launcher_takes_over(workspace, instance, steering, monkeypatch):
    recipe = steering / "recipe.yaml"
    recipe.write_text("nonsense: true\n", "utf-8")
    launcher = instance.run_launcher
    monkeypatch.setattr(launcher, "settings", replace(launcher.settings, state_folder=None))
    monkeypatch.setenv("BAGASSETS_RECIPE", str(recipe))
    run_id = click(workspace, "whole", key=None)
    assert ended(instance, run_id) == "SUCCESS"
    assert "default launcher" in messages(instance, run_id)
    assert str(recipe) in messages(instance, run_id)
    run = instance.get_run_by_id(run_id)
    assert instance.run_launcher.check_run_worker_health(run).status == WorkerStatus.RUNNING


def test_code_of_another_environment_is_left_to_the_default_launcher(instance):
    location = CodeLocation("small_definitions", working_directory=str(TESTS))
    run = instance.get_run_by_id(create_run(instance, ["whole"], location=location))
    elsewhere = run.job_code_origin.repository_origin._replace(executable_path="/other/bin/python")
    foreign = run._replace(job_code_origin=run.job_code_origin._replace(repository_origin=elsewhere))
    launched = []

    class Context:
        dagster_run = foreign

    launcher = BagAssetsRunLauncher()
    launcher.register_instance(instance)
    launcher._default.launch_run = launched.append
    launcher.launch_run(Context)
    assert launched == [Context]
    assert "/other/bin/python" in messages(instance, run.run_id)
    instance.report_run_canceled(run)


def test_runs_of_one_recording_take_turns(workspace, instance, steering):
    (steering / "hold").touch()
    runs = [click(workspace, "first", key="walk") for _ in range(3)]
    eventually((steering / "spans").exists)
    eventually(lambda: sum("Waiting for another run" in messages(instance, run) for run in runs) == 2)
    assert ended(instance, click(workspace, "second", key="drive")) == "SUCCESS", "another recording goes on"
    (steering / "hold").unlink()
    assert {ended(instance, run) for run in runs} == {"SUCCESS"}
    spans = [line.split() for line in (steering / "spans").read_text().splitlines()]
    assert [what for what, _, _ in spans] == ["begin", "end"] * 3
    assert [run for _, _, run in spans[::2]] == [run for _, _, run in spans[1::2]]


# --- cancelling --------------------------------------------------------------------------


def test_cancelling_from_another_process_ends_canceled_despite_a_retry_policy(workspace, instance, steering):
    run_id = click(workspace, "patient")
    wait_for_attempt(steering)
    assert terminate_elsewhere(instance.root_directory, run_id)
    assert ended(instance, run_id) == "CANCELED"
    assert (steering / "attempts").read_text().count("attempt") == 1
    eventually(lambda: not worker_of(instance, run_id).is_alive(), "the worker is gone")


def test_cancelling_in_the_web_ui(workspace, instance, steering):
    run_id = click(workspace, "patient")
    wait_for_attempt(steering)
    assert mutate(workspace, TERMINATE, run=run_id)["__typename"] == "TerminateRunSuccess"
    assert ended(instance, run_id) == "CANCELED"


def test_a_step_that_does_not_stop_is_killed_and_its_run_canceled(workspace, instance, steering):
    run_id = click(workspace, "stubborn")
    wait_for_attempt(steering)
    assert instance.run_launcher.terminate(run_id)
    assert ended(instance, run_id) == "CANCELED"
    assert not worker_of(instance, run_id).is_alive()


def test_a_run_that_waits_for_its_turn_can_be_cancelled(workspace, instance, steering):
    (steering / "hold").touch()
    working = click(workspace, "first")
    eventually((steering / "spans").exists)
    waiting = click(workspace, "first")
    eventually(lambda: "Waiting for another run" in messages(instance, waiting))
    assert instance.run_launcher.terminate(waiting)
    assert ended(instance, waiting) == "CANCELED"
    (steering / "hold").unlink()
    assert ended(instance, working) == "SUCCESS"


def test_a_run_that_waits_for_its_turn_can_be_canceled_by_force(workspace, instance, steering):
    """All that the web UI offers for a run that is about to start."""
    (steering / "hold").touch()
    working = click(workspace, "first")
    eventually((steering / "spans").exists)
    waiting = click(workspace, "first")
    eventually(lambda: "Waiting for another run" in messages(instance, waiting))
    worker = worker_of(instance, waiting)
    policy = "MARK_AS_CANCELED_IMMEDIATELY"
    assert mutate(workspace, TERMINATE, run=waiting, policy=policy)["__typename"] == "TerminateRunSuccess"
    eventually(lambda: not worker.is_alive(), "the worker gives up")
    (steering / "hold").unlink()
    assert ended(instance, working) == "SUCCESS"
    assert status_of(instance, waiting) == "CANCELED"


def test_a_finished_run_cannot_be_cancelled(workspace, instance):
    run_id = click(workspace, "whole", key=None)
    ended(instance, run_id)
    assert not instance.run_launcher.terminate(run_id)


def test_a_run_of_another_machine_cannot_be_cancelled_from_here(instance):
    run_id = create_run(instance, ["whole"], location=LOCATION)
    far = ProcessId("another-machine", "", 1, "1")
    instance.add_run_tags(run_id, RunWorker(run_id, far, far).tags())
    assert not instance.run_launcher.terminate(run_id)
    assert "another-machine" in messages(instance, run_id)
    run = instance.get_run_by_id(run_id)
    assert instance.run_launcher.check_run_worker_health(run).status == WorkerStatus.RUNNING
    instance.report_run_canceled(run)


# --- what dies ---------------------------------------------------------------------------


def test_the_run_of_a_killed_worker_fails_with_the_reason(workspace, instance, steering):
    run_id = click(workspace, "patient")
    wait_for_attempt(steering)
    worker = worker_of(instance, run_id)
    assert instance.run_launcher.check_run_worker_health(instance.get_run_by_id(run_id)).status == (
        WorkerStatus.RUNNING
    )
    assert worker.process.send(signal.SIGKILL)
    assert ended(instance, run_id) == "FAILURE"
    assert "SIGKILL" in messages(instance, run_id)
    health = instance.run_launcher.check_run_worker_health(instance.get_run_by_id(run_id))
    assert health.status == WorkerStatus.FAILED


@pytest.mark.once
def test_a_run_survives_its_server_and_can_still_be_cancelled(workspace, instance, steering):
    survivor, victim = click(workspace, "patient", key="drive"), click(workspace, "patient", key="walk")
    eventually(
        lambda: (steering / "attempts").exists() and (steering / "attempts").read_text().count("attempt") == 2
    )
    worker, server = worker_of(instance, victim), worker_of(instance, survivor).server
    assert server.send(signal.SIGKILL)
    eventually(lambda: not server.is_alive())
    assert worker.process.send(signal.SIGKILL)
    eventually(lambda: not worker.process.is_alive())
    assert status_of(instance, victim) == "STARTED", "nobody is there to report it"

    assert ended(instance, click(workspace, "whole", key=None)) == "SUCCESS"  # starts the next server
    assert ended(instance, victim) == "FAILURE"
    assert "gone" in messages(instance, victim)
    assert status_of(instance, survivor) == "STARTED"
    assert instance.run_launcher.terminate(survivor)
    assert ended(instance, survivor) == "CANCELED"


@pytest.mark.once
def test_a_run_whose_server_died_before_the_fork_is_reported(instance, place):
    run_id = create_run(instance, ["whole"], location=LOCATION)
    gone = ProcessId(**{**ProcessId.current().as_json(), "started": "long ago"})
    instance.add_run_tags(run_id, RunWorker(run_id, gone).tags())
    with connect(server_spec(place / "recovering", None, modules=()), instance.root_directory) as client:
        assert ended(instance, run_id) == "FAILURE"
        client.shutdown()


@pytest.mark.once
def test_an_orphan_that_dies_later_is_noticed(workspace, instance, steering):
    run_id = click(workspace, "patient")
    wait_for_attempt(steering)
    worker = worker_of(instance, run_id)
    assert worker.server.send(signal.SIGKILL)
    eventually(lambda: not worker.server.is_alive())
    assert ended(instance, click(workspace, "whole", key=None)) == "SUCCESS"
    assert status_of(instance, run_id) == "STARTED"
    assert worker.process.send(signal.SIGKILL)
    assert ended(instance, run_id) == "FAILURE"


def begin_to_start(instance, run_id, *, waited_s):
    """Leave a run as a launcher does that is killed before it hands the run over, some time ago."""
    starting = DagsterEvent(DagsterEventType.PIPELINE_STARTING.value, "__ASSET_JOB", message="about to start")
    instance.report_dagster_event(starting, run_id)
    age(instance, run_id, waited_s)


def age(instance, run_id, waited_s):
    then = dt.datetime.now(dt.UTC).replace(tzinfo=None) - dt.timedelta(seconds=waited_s)
    path = Path(instance.root_directory) / "history" / "runs.db"
    with closing(sqlite3.connect(path)) as runs:
        runs.execute("UPDATE runs SET update_timestamp = ? WHERE run_id = ?", (str(then), run_id))
        runs.commit()


def test_a_run_that_nobody_launched_is_reported_after_a_while_and_not_before(instance):
    young, old, never = (create_run(instance, ["whole"], location=LOCATION) for _ in range(3))
    begin_to_start(instance, young, waited_s=UNTAKEN_S - 60)
    begin_to_start(instance, old, waited_s=UNTAKEN_S + 1)
    age(instance, never, UNTAKEN_S + 1)
    reported, watched_by_nobody = end_orphaned_runs(instance)
    assert (set(reported), watched_by_nobody) == ({old, never}, 1)
    assert [status_of(instance, run_id) for run_id in (young, old, never)] == [
        "STARTING",
        "FAILURE",
        "FAILURE",
    ]
    assert "No worker took this run within 300 s" in messages(instance, old)
    age(instance, young, UNTAKEN_S + 1)
    assert end_orphaned_runs(instance) == ([young], 0)


def test_a_run_that_was_never_handed_to_its_server_is_reported(instance, builder):
    run_id = create_run(instance, ["whole"], location=LOCATION)
    begin_to_start(instance, run_id, waited_s=0)
    instance.add_run_tags(run_id, RunWorker(run_id, builder.process).tags())
    age(instance, run_id, UNTAKEN_S - 60)
    assert end_orphaned_runs(instance) == ([], 1)
    age(instance, run_id, UNTAKEN_S + 1)
    assert end_orphaned_runs(instance) == ([run_id], 0)


@pytest.mark.once
def test_runs_of_others_are_not_taken_for_left_behind(instance, tmp_path, workspace, steering):
    started = create_run(instance, ["whole"], location=LOCATION)
    begin_to_start(instance, started, waited_s=0)
    begun = DagsterEvent(DagsterEventType.PIPELINE_START.value, "__ASSET_JOB", message="elsewhere")
    instance.report_dagster_event(begun, started)
    age(instance, started, 2 * UNTAKEN_S)
    left_to_dagster = create_run(instance, ["whole"], location=LOCATION)
    begin_to_start(instance, left_to_dagster, waited_s=0)
    with socket.socket(socket.AF_UNIX) as server:
        place = f"/tmp/{uuid4().hex}"
        server.bind(place)
        server.listen()
        tag = {GRPC_INFO_TAG: json.dumps({"host": "localhost", "socket": place}), WORKER_TAG: ""}
        instance.add_run_tags(left_to_dagster, tag)
        age(instance, left_to_dagster, 2 * UNTAKEN_S)
        assert end_orphaned_runs(instance) == ([], 0)
        Path(place).unlink()
    assert end_orphaned_runs(instance) == ([left_to_dagster], 0)
    instance.report_run_failed(instance.get_run_by_id(started))
    waits = click(workspace, "patient")
    wait_for_attempt(steering)
    age(instance, waits, 2 * UNTAKEN_S)
    assert end_orphaned_runs(instance) == ([], 0)
    assert instance.run_launcher.terminate(waits)
    assert ended(instance, waits) == "CANCELED"


@pytest.mark.once
def test_a_server_that_is_asked_for_reports_what_was_left_behind_before(instance, place):
    run_id = create_run(instance, ["whole"], location=LOCATION)
    begin_to_start(instance, run_id, waited_s=UNTAKEN_S - 1)
    with connect(server_spec(place / "waiting", None, modules=()), instance.root_directory) as client:
        assert ended(instance, run_id) == "FAILURE"
        client.shutdown()


# --- jobs that execute runs --------------------------------------------------------------


@pytest.fixture
def builder(place, instance):
    with Client.ensure(server_spec(place / "state", None, modules=("small_definitions",))) as client:
        yield client


def test_a_run_that_exists_can_be_executed_by_a_job(builder, instance):
    run_id = create_run(instance, ["whole"], location=LOCATION)
    submit_run(builder, instance.root_directory, run_id)
    assert builder.wait(WAIT_S)["result"] == "SUCCESS"
    assert instance.get_run_by_id(run_id).is_success


def test_a_deleted_run_is_refused_with_a_sentence(builder, instance):
    submit_run(builder, instance.root_directory, "00000000-0000-0000-0000-000000000000")
    assert "deleted" in builder.wait(WAIT_S)["error"]["message"]
