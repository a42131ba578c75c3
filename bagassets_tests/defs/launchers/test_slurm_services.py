"""The sensor, the daemon and the web server of `bagassets ui`: their runs are executed by a real Slurm."""

import json
import signal
from urllib.request import Request, urlopen

import dagster as dg
import pytest

from bagassets.defs.records.instances import open_instance
from bagassets_tests.defs.launchers.test_slurm_build import use_slurm
from bagassets_tests.services import BIN, eventually, free_port, make_project, running
from bagassets_tests.slurm_cluster import NODES
from bagassets_tests.small_drive import write_drive

pytestmark = [pytest.mark.long, pytest.mark.xdist_group("slurm-services")]

LAUNCH = """
mutation Launch($params: ExecutionParams!) {
  launchPipelineExecution(executionParams: $params) {
    __typename ... on LaunchRunSuccess { run { runId } } ... on PythonError { message }
  }
}
"""
TERMINATE = """
mutation Terminate($run: String!) {
  terminateRun(runId: $run, terminatePolicy: MARK_AS_CANCELED_IMMEDIATELY) { __typename ... on TerminateRunFailure { message } ... on PythonError { message } }
}
"""


def mutate(url, mutation, **variables):
    body = json.dumps({"query": mutation, "variables": variables}).encode()
    with urlopen(Request(f"{url}/graphql", body, {"Content-Type": "application/json"}), timeout=60) as answer:
        (found,) = json.load(answer)["data"].values()
    return found


def click(url, *assets, key):
    """Materialize assets of a recording as the web UI does; return the run's id."""
    params = {
        "selector": {
            "repositoryLocationName": "bagassets.definitions",
            "repositoryName": "__repository__",
            "pipelineName": "__ASSET_JOB",
            "assetSelection": [{"path": [asset]} for asset in assets],
        },
        "executionMetadata": {"tags": [{"key": "dagster/partition", "value": key}]},
    }
    found = mutate(url, LAUNCH, params=params)
    assert found["__typename"] == "LaunchRunSuccess", found
    return found["run"]["runId"]


def keys_in(project):
    try:
        lock = project / "dataset" / "nuscenes" / "v1.0-test" / "dataset.lock.json"
        return {bag["key"] for bag in json.loads(lock.read_text())["bags"]}
    except FileNotFoundError:  # not there yet, or being exchanged
        return set()


@pytest.fixture
def drain(slurm):
    """Have no node take jobs, until the test ends."""

    def change(*settings):
        for node in NODES:
            slurm.ask("scontrol", "update", f"NodeName={node}", *settings)

    yield lambda: change("State=DRAIN", "Reason=test")
    change("State=RESUME")


def test_what_the_sensor_and_the_web_ui_ask_for_is_executed_by_slurm(tmp_path, slurm, drain):
    write_drive(tmp_path / "bags" / "a.bag", "ros1", duration_s=1.0)
    project = make_project(tmp_path)
    use_slurm(project / "recipe.yaml")
    log, port = tmp_path / "ui.log", free_port()
    url = f"http://127.0.0.1:{port}"
    command = [BIN / "bagassets", "ui", "--recipe", project / "recipe.yaml", "--port", port, "--no-browser"]
    with (
        open_instance(str(project)) as instance,
        running(command, project, log, slurm.environment) as process,
    ):

        def ended(run_id):
            found = instance.get_run_by_id(run_id)
            return found if found.is_finished else None

        eventually(lambda: keys_in(project) == {"a.bag"}, "what was there is in the dataset", 180)
        write_drive(tmp_path / "new.bag", "ros1", duration_s=1.2).rename(tmp_path / "bags" / "b.bag")
        eventually(lambda: keys_in(project) == {"a.bag", "b.bag"}, "the new recording is in the dataset", 180)
        eventually(lambda: all(run.is_finished for run in instance.get_runs()), "all runs have ended")
        by_sensor = instance.get_runs()
        assert {run.status for run in by_sensor} == {dg.DagsterRunStatus.SUCCESS}
        assert {run.tags.get("dagster/sensor_name") for run in by_sensor} == {"recordings"}, [
            run.tags for run in by_sensor
        ]
        assert {run.tags["slurm/node"] for run in by_sensor} <= {"n1", "n2"}

        clicked = eventually(
            lambda run_id=click(url, "bag", "inventory", key="b.bag"): ended(run_id), "it ends"
        )
        assert clicked.status == dg.DagsterRunStatus.SUCCESS
        assert clicked.tags["slurm/node"] in {"n1", "n2"}

        drain()
        # A job that waits for more runs would take this one.
        eventually(lambda: slurm.ask("squeue", "--noheader") == "", "no job is left")
        waiting = click(url, "bag", "inventory", key="a.bag")
        eventually(
            lambda: "is queued (" in instance.get_run_by_id(waiting).tags.get("bagassets/where", ""),
            "the run shows why it waits",
        )
        assert instance.get_run_by_id(waiting).status == dg.DagsterRunStatus.STARTING
        # Dagster's other policy is for runs that have started.
        found = mutate(url, TERMINATE, run=waiting)
        assert found["__typename"] == "TerminateRunSuccess", found
        assert eventually(lambda: ended(waiting), "it ends").status == dg.DagsterRunStatus.CANCELED
        eventually(lambda: slurm.ask("squeue", "--noheader") == "", "its job is cancelled")

        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 0
    assert log.read_text().splitlines() == [f"{url}  (web UI of project; Ctrl-C ends it)"]
