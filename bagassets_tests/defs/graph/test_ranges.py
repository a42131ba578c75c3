"""Runs about a range of recordings, as a backfill of the web UI has them: what each is about, and what becomes of each recording."""

import signal
import time
from contextlib import contextmanager

import dagster as dg
import pytest
from dagster._core.event_api import PartitionKeyFilter

from bagassets.base.lock_files import RUN_LOCKS
from bagassets.defs.builds.old_runs import superseded_runs
from bagassets.defs.builds.pending_work import open_project
from bagassets.defs.graph.location import build_definitions
from bagassets.defs.graph.sensor_cursor import Cursor
from bagassets.defs.graph.sensor_scan import Scan
from bagassets.defs.graph.steps import per_recording
from bagassets.defs.records.batches import recordings_of
from bagassets.defs.records.events import Records
from bagassets.defs.records.naming import Naming
from bagassets.defs.records.partitions import active_runs, add_partitions
from bagassets.defs.runs.exclusive import exclusive
from bagassets.defs.runs.execution import create_run, execute_run, failure_of
from bagassets.engine.batches import MOST_RECORDINGS
from bagassets.forkserver.client import Client
from bagassets.forkserver.process import ProcessId
from bagassets.forkserver.tasks import server_spec, submit_run
from bagassets.recipe import load_recipe
from bagassets_tests.doors import shown_partitions
from bagassets_tests.in_process import build, load_definitions, make_project, states, survey
from bagassets_tests.services import eventually
from bagassets_tests.small_drive import write_drive

pytestmark = pytest.mark.once

NAMES = Naming("test")
KEYS = ("d.bag", "a.bag", "c.bag", "b.bag")  # in the order in which they are registered
POLICY = dg.BackfillPolicy.multi_run(MOST_RECORDINGS)


def make(folder):
    """Write a project of small recordings, and register them; return its recipe file."""
    recipe_file = make_project(folder, ())
    for number, key in enumerate(KEYS):
        write_drive(folder / "bags" / key, "ros1", duration_s=1.0 + 0.1 * number)
    with open_project(recipe_file) as workspace:
        instance = workspace.instance
        add_partitions(Records(instance, NAMES), KEYS)
    return recipe_file


@pytest.fixture
def project(tmp_path, monkeypatch):
    recipe_file = make(tmp_path)
    monkeypatch.setenv("BAGASSETS_RECIPE", str(recipe_file))
    monkeypatch.delenv("DAGSTER_HOME", raising=False)
    load_definitions(recipe_file)
    return recipe_file


def create(instance, first, last, selection="group:recording"):
    """Create a run as the daemon does for a backfill; return its id."""
    return create_run(instance, dg.AssetSelection.from_string(selection), tags=ends(first, last))


def ends(first, last):
    return {"dagster/asset_partition_range_start": first, "dagster/asset_partition_range_end": last}


def materialize(instance, first, last, selection="group:recording"):
    """Have a run of a range; return it."""
    run_id = create(instance, first, last, selection)
    execute_run(instance, run_id)
    return instance.get_run_by_id(run_id)


def shown(instance, asset, recipe_file):
    graph = build_definitions(recipe_file).resolve_asset_graph()
    return shown_partitions(instance, dg.AssetKey(asset), graph.get(dg.AssetKey(asset)).partitions_def)


def test_backfills_share_runs_where_a_fork_server_executes_them(project, monkeypatch):
    def policies():
        graph = build_definitions(project).resolve_asset_graph()
        return {
            graph.get(key).backfill_policy
            for key in graph.materializable_asset_keys
            if graph.get(key).is_partitioned
        }

    assert policies() == {POLICY}
    monkeypatch.setenv("DAGSTER_HOME", str(project.parent / "elsewhere"))  # Dagster's own launcher
    assert policies() == {None}


def test_a_run_of_a_range_makes_what_is_registered_from_one_to_the_other_and_nothing_else(project):
    with open_project(project) as workspace:
        instance = workspace.instance
        run = materialize(instance, "a.bag", "c.bag")
        assert run.status == dg.DagsterRunStatus.SUCCESS
        assert shown(instance, "nuscenes_tables", project) == {"made": {"a.bag", "c.bag"}, "failed": set()}
        assert recordings_of(Records(instance, NAMES))(run) == ("a.bag", "c.bag")
    assert set(states(survey(project), "a.bag").values()) == {"fresh"}
    assert states(survey(project), "d.bag")["bag"] == "missing"


def checks(instance, recipe_file, key):
    """Return the states of the checks of a recording, as Dagster keeps them."""
    found = list(build_definitions(recipe_file).resolve_asset_graph().asset_check_keys)
    storage = instance.event_log_storage
    latest = storage.get_latest_asset_check_execution_by_key(found, PartitionKeyFilter(key=key))
    return {record.status.value for record in latest.values()}


def test_one_that_fails_is_red_alone_and_one_that_is_skipped_has_no_red_check(project):
    (project.parent / "bags" / "a.bag").write_bytes(b"no bag at all")
    text = project.read_text().replace("settle_s: 0", "settle_s: 0, min_duration_s: 1.05")
    project.write_text(text)  # d.bag is too short
    load_definitions(project)
    with open_project(project) as workspace:
        instance = workspace.instance
        run = materialize(instance, "d.bag", "b.bag")
        assert run.status == dg.DagsterRunStatus.FAILURE
        made = {"b.bag", "c.bag", "d.bag"}
        assert shown(instance, "nuscenes_tables", project) == {"made": made, "failed": {"a.bag"}}
        assert "a.bag" in Records(instance, NAMES).last_failure("nuscenes_tables", "a.bag")
        # What was planned and not made in a run that failed is red.
        assert checks(instance, project, "a.bag") == {"PLANNED"}
        assert checks(instance, project, "b.bag") == {"SUCCEEDED"}
        assert checks(instance, project, "d.bag") == set()
        assert "1 of 4 recordings failed; the others are recorded. a.bag: " in failure_of(instance, run)
    bags = survey(project).plan.bags
    assert bags["d.bag"].skipped
    assert bags["a.bag"].failed is not None
    assert all(asset.is_settled for key in made for asset in bags[key].assets.values())


@pytest.mark.parametrize("door", ["command", "range"])
def test_a_check_that_did_not_pass_is_red_no_more_once_its_recording_is_skipped(project, monkeypatch, door):
    text = project.read_text()
    project.write_text(f"{text}\nchecks: {{topic_rates: {{limits: {{/odom: {{min_hz: 60}}}}}}}}\n")
    load_definitions(project)

    def make():
        if door == "command":
            build(project, monkeypatch)
        else:
            with open_project(project) as workspace:
                instance = workspace.instance
                materialize(instance, "d.bag", "b.bag")
        with open_project(project) as workspace:
            instance = workspace.instance
            return {key: checks(instance, project, key) for key in KEYS}

    some_red = {key: {"SUCCEEDED", "FAILED"} for key in KEYS}
    assert make() == some_red
    project.write_text(project.read_text().replace("settle_s: 0", "settle_s: 0, min_duration_s: 1.05"))
    load_definitions(project)
    assert make() == some_red | {"d.bag": {"SUCCEEDED"}}


def test_some_assets_of_some_recordings(project, monkeypatch):
    """A step that reads nothing of the first one has nothing left to do."""
    build(project, monkeypatch)
    with open_project(project) as workspace:
        instance = workspace.instance
        run = materialize(instance, "d.bag", "b.bag", "key:bag or key:nuscenes_tables")
        assert run.status == dg.DagsterRunStatus.SUCCESS
        made = instance.all_logs(run.run_id, of_type=dg.DagsterEventType.ASSET_MATERIALIZATION)
        said = sorted(
            (one.asset_materialization.partition, one.asset_materialization.asset_key.path[-1])
            for one in made
        )
    assert said == sorted((key, name) for key in KEYS for name in ("bag", "nuscenes_tables"))
    assert survey(project).is_settled


def test_a_run_that_has_not_ended_is_about_all_of_its_range(project):
    with open_project(project) as workspace:
        instance = workspace.instance
        run_id = create(instance, "a.bag", "b.bag")
        assert active_runs(Records(instance, NAMES), ()) == {run_id: ("a.bag", "c.bag", "b.bag")}
        assert active_runs(Records(instance, Naming("test", ("other",))), ()) == {}
        scan = Scan(workspace, Cursor())
        assert [request.partition_key for request in scan.scan(1e9)] == ["d.bag"]


def test_what_was_asked_for_and_cancelled_as_a_range_is_not_asked_for_again(project):
    with open_project(project) as workspace:
        instance = workspace.instance
        scan = Scan(workspace, Cursor())
        assert len(scan.scan(1e9)) == 1
        run_id = create(instance, "d.bag", "b.bag")
        instance.report_run_canceled(instance.get_run_by_id(run_id))
        assert scan.scan(1e9 + 100) == []


def test_runs_of_ranges_are_superseded_as_others_are(project):
    recipe = load_recipe(project)
    with open_project(project) as workspace:
        instance = workspace.instance
        first, second = (materialize(instance, "d.bag", "b.bag").run_id for _ in range(2))
        third = materialize(instance, "d.bag", "a.bag").run_id
        assert superseded_runs(Records(instance, NAMES), recipe, time.time() + 1) == [first]
        fourth = materialize(instance, "d.bag", "b.bag").run_id
        found = superseded_runs(Records(instance, NAMES), recipe, time.time() + 1)
        assert found == [third, second, first]
        assert fourth not in found


def test_a_range_whose_end_is_gone_is_about_its_ends(project):
    with open_project(project) as workspace:
        instance = workspace.instance
        run = instance.get_run_by_id(create(instance, "d.bag", "c.bag"))
        instance.delete_dynamic_partition(NAMES.partitions, "c.bag")
        assert recordings_of(Records(instance, NAMES))(run) == ("d.bag", "c.bag")


def test_assets_of_others_with_the_same_policy_are_refused(project):
    @dg.asset(partitions_def=per_recording(load_recipe(project)), deps=["frames"], backfill_policy=POLICY)
    def mine():
        return None

    definitions = dg.Definitions.merge(build_definitions(project), dg.Definitions(assets=[mine]))
    job = definitions.resolve_implicit_global_asset_job_def()
    with open_project(project) as workspace:
        instance = workspace.instance
        selection = dg.AssetSelection.from_string("group:recording or key:mine").resolve(
            job.asset_layer.asset_graph
        )
        run = job.execute_in_process(
            instance=instance,
            tags=ends("d.bag", "a.bag"),
            asset_selection=sorted(selection),
            raise_on_error=False,
        )
        [failure] = run.get_step_failure_events()
        assert "mine: the backfill policy is that of bagassets" in failure.step_failure_data.error.message
        assert made(instance) == set()


# --- in a worker of the fork server ----------------------------------------------------------


@contextmanager
def worker(project, first="d.bag", last="b.bag"):
    """Have a worker of the fork server execute a run of a range; yield instance, client and the id of the run."""
    spec = server_spec(load_recipe(project).state, project)
    with open_project(project) as workspace, Client.ensure(spec) as client:
        instance = workspace.instance
        run_id = create(instance, first, last)
        submit_run(client, str(project.parent), run_id)
        yield instance, client, run_id
        client.shutdown(grace_s=0.0)


def parts(client):
    return [job for job in client.status()["jobs"] if job["function"].endswith(":make_part")]


def held(project, key):
    """Hold the lock of a recording, so that whoever makes it waits."""
    return exclusive(load_recipe(project).state / RUN_LOCKS, key, keep_waiting=lambda _: False)


def test_processes_beside_the_worker_make_the_recordings(project, monkeypatch):
    monkeypatch.setattr("os.cpu_count", lambda: 2)
    with held(project, "a.bag"), worker(project) as (instance, client, run_id):
        eventually(lambda: len(parts(client)) == 1 and made(instance) == set(KEYS) - {"a.bag"}, "one is left")
        ProcessId.from_json(parts(client)[0]["process"]).send(signal.SIGKILL)
        assert client.wait(60)["result"] == "FAILURE"
        assert shown(instance, "nuscenes_tables", project) == {
            "made": set(KEYS) - {"a.bag"},
            "failed": {"a.bag"},
        }
        said = failure_of(instance, instance.get_run_by_id(run_id))
        assert "1 of 4 recordings failed" in said
        assert "the process that made it is gone" in said
    build(project, monkeypatch)
    assert survey(project).is_settled


def made(instance):
    return set(instance.get_materialized_partitions(dg.AssetKey("nuscenes_tables")))


def test_they_end_with_a_run_that_is_cancelled(project, monkeypatch):
    with held(project, "a.bag"), worker(project) as (instance, client, run_id):
        # The last one of its process: none waits behind it.
        # Tables are recorded before the rest: a recording that is cancelled between them is not fresh yet.
        eventually(lambda: set(survey(project).todo) == {"a.bag"}, "the others are recorded")
        [job] = [job for job in client.status()["jobs"] if job["label"] == run_id]
        instance.report_run_canceling(instance.get_run_by_id(run_id))
        client.cancel(job["job"])
        assert client.wait(60)["result"] == "CANCELED"
        eventually(lambda: not parts(client), "nobody is at work")
        assert active_runs(Records(instance, NAMES), ()) == {}
    report, _ = build(project, monkeypatch)
    assert {key: one.result for key, one in report.outcomes.items()} == {
        key: "built" if key == "a.bag" else "fresh" for key in KEYS
    }
