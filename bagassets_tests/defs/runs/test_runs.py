"""Creating and executing runs in this process: every use of Dagster's private API."""

import subprocess
import sys
from pathlib import Path

import dagster as dg
import pytest
import small_definitions
from dagster._core.execution import compute_logs

from bagassets.base.errors import BagAssetsError
from bagassets.defs.builds.pending_work import open_project, rehearse
from bagassets.defs.records.instances import dotenv_variables, open_instance, pack_instance
from bagassets.defs.records.partitions import add_partitions
from bagassets.defs.runs import execution as runs
from bagassets.defs.runs.execution import CodeLocation, create_run, execute_run, failure_of, mark_canceling
from bagassets_tests.in_process import make_project

TESTS = Path(__file__).parents[2]
LOCATION = CodeLocation("small_definitions", working_directory=str(TESTS))


@pytest.fixture
def instance(tmp_path, monkeypatch):
    monkeypatch.setenv("SMALL_DEFINITIONS", str(tmp_path))
    home = tmp_path / "home"
    home.mkdir()
    (home / "dagster.yaml").write_text("telemetry: {enabled: false}\n", "utf-8")
    with open_instance(str(home)) as instance:
        instance.add_dynamic_partitions(small_definitions.recordings.name, ["drive", "walk"])
        yield instance


def create(instance, *assets, partition_key="drive", **options):
    return create_run(instance, assets, partition_key=partition_key, location=LOCATION, **options)


def events(instance, run_id):
    return [
        entry.dagster_event.event_type_value for entry in instance.all_logs(run_id) if entry.dagster_event
    ]


def attempts(tmp_path):
    return (tmp_path / "attempts").read_text().count("attempt")


# --- creating ----------------------------------------------------------------------------


def test_a_created_run_is_what_the_web_ui_would_create(instance):
    run = instance.get_run_by_id(create(instance, "first", "second", tags={"why": "stale"}))
    assert run.status == dg.DagsterRunStatus.NOT_STARTED
    assert run.asset_selection == {dg.AssetKey("first"), dg.AssetKey("second")}
    assert run.tags["dagster/partition"] == "drive"
    assert run.tags["dagster/code_location"] == "small_definitions"
    assert run.tags["why"] == "stale"
    assert run.remote_job_origin.location_name == "small_definitions"
    assert run.remote_job_origin.repository_origin.repository_name == "__repository__"
    assert run.job_name == run.remote_job_origin.job_name
    pointer = run.job_code_origin.repository_origin.code_pointer
    assert (pointer.module, pointer.fn_name, pointer.working_directory) == (
        "small_definitions",
        "defs",
        str(TESTS),
    )
    assert run.job_code_origin.repository_origin.executable_path == sys.executable
    assert instance.get_runs(dg.RunsFilter(tags={".dagster/repository": "__repository__@small_definitions"}))


def test_the_location_may_have_a_name_and_the_run_an_id(instance):
    location = CodeLocation("small_definitions", name="named", working_directory=str(TESTS))
    run_id = "8b9e1c1e-7a57-4a52-a6a5-3a1f2f6f0a11"
    assert create_run(instance, ["whole"], location=location, run_id=run_id) == run_id
    assert instance.get_run_by_id(run_id).remote_job_origin.location_name == "named"


def test_assets_may_be_selected_by_selection(instance):
    selection = dg.AssetSelection.assets("second").upstream()
    run_id = create_run(instance, selection, partition_key="walk", location=LOCATION)
    assert instance.get_run_by_id(run_id).asset_selection == {dg.AssetKey("first"), dg.AssetKey("second")}


@pytest.mark.parametrize(
    ("assets", "key", "word"),
    [
        (["nothing"], "drive", "nothing"),
        ([], "drive", "none"),
        (["first"], "no such drive", "no such drive"),
    ],
)
def test_what_cannot_be_run_is_refused_with_a_sentence(instance, assets, key, word):
    with pytest.raises(BagAssetsError, match=word):
        create(instance, *assets, partition_key=key)
    assert instance.get_runs_count() == 0


# --- executing ---------------------------------------------------------------------------


def test_an_executed_run_succeeds_without_having_been_queued(instance):
    run_id = create(instance, "first", "second")
    assert execute_run(instance, run_id) == "SUCCESS"
    found = events(instance, run_id)
    assert "PIPELINE_ENQUEUED" not in found
    assert "STEP_FAILURE" not in found
    assert found.count("ASSET_MATERIALIZATION") == 2
    assert "ASSET_CHECK_EVALUATION" in found, "checks belong to the run"
    event = instance.get_latest_materialization_event(dg.AssetKey("second"))
    assert event.run_id == run_id
    assert event.asset_materialization.partition == "drive"


def test_an_unpartitioned_asset_needs_no_key(instance):
    assert execute_run(instance, create(instance, "whole", partition_key=None)) == "SUCCESS"


def test_a_failure_is_reported_in_the_librarys_own_words(instance):
    run_id = create(instance, "broken")
    assert execute_run(instance, run_id) == "FAILURE"
    assert events(instance, run_id).count("STEP_FAILURE") == 1
    sentence = "drive.bag: the recording is truncated; copy it again."
    assert failure_of(instance, instance.get_run_by_id(run_id)) == sentence


def test_an_unknown_run_is_refused(instance):
    with pytest.raises(BagAssetsError, match="00000000"):
        execute_run(instance, "00000000-0000-0000-0000-000000000000")


def test_compute_logs_are_kept_without_processes_that_copy_them(instance, monkeypatch):
    started = []
    real = subprocess.Popen
    monkeypatch.setattr(subprocess, "Popen", lambda *a, **k: started.append(a) or real(*a, **k))
    original = compute_logs.tail_to_stream
    run_id = create(instance, "first")
    execute_run(instance, run_id)
    assert started == []
    assert compute_logs.tail_to_stream is original
    (captured,) = [
        entry.dagster_event.logs_captured_data
        for entry in instance.all_logs(run_id)
        if entry.dagster_event and entry.dagster_event.event_type_value == "LOGS_CAPTURED"
    ]
    key = [run_id, "compute_logs", captured.file_key]
    assert b"printed by first" in instance.compute_log_manager.get_log_data(key).stdout


# --- cancelling --------------------------------------------------------------------------


def test_a_run_cancelled_before_it_starts_is_canceled(instance, tmp_path):
    run_id = create(instance, "patient")
    instance.report_run_canceling(instance.get_run_by_id(run_id))
    assert execute_run(instance, run_id) == "CANCELED"
    assert not (tmp_path / "attempts").exists()


def test_a_run_cancelled_while_its_code_loads_is_canceled(instance, tmp_path, monkeypatch):
    run_id = create(instance, "patient")
    real = runs.core_execute_run

    def mark_first(job, run, *args, **kwargs):
        instance.report_run_canceling(run)
        return real(job, run, *args, **kwargs)

    monkeypatch.setattr(runs, "core_execute_run", mark_first)
    assert execute_run(instance, run_id) == "CANCELED"
    assert "PIPELINE_FAILURE" not in events(instance, run_id)
    assert not (tmp_path / "attempts").exists()


@pytest.mark.parametrize("end", ["CANCELED", "SUCCESS"])
def test_a_run_that_ends_while_it_is_marked_keeps_the_state_it_ended_with(instance, monkeypatch, end):
    """Its worker has read the event, and recorded the end, before the state CANCELING is written."""
    run_id = create(instance, "first")
    real = instance.run_storage.handle_run_event

    def end_first(run_id, event, *args):
        if event.event_type == dg.DagsterEventType.PIPELINE_CANCELING:
            run = instance.get_run_by_id(run_id)
            if end == "CANCELED":
                instance.report_run_canceled(run)
            else:
                done = dg.DagsterEvent(dg.DagsterEventType.PIPELINE_SUCCESS.value, run.job_name)
                instance.report_dagster_event(done, run_id)
        real(run_id, event, *args)

    monkeypatch.setattr(instance.run_storage, "handle_run_event", end_first)
    assert not mark_canceling(instance, instance.get_run_by_id(run_id))
    assert instance.get_run_by_id(run_id).status.value == end


def test_a_run_canceled_by_force_is_not_executed(instance, tmp_path):
    run_id = create(instance, "patient")
    instance.report_run_canceled(instance.get_run_by_id(run_id))
    assert execute_run(instance, run_id) == "CANCELED"
    assert not (tmp_path / "attempts").exists()


def test_an_interrupted_run_that_is_marked_is_canceled_and_not_retried(instance, tmp_path):
    (tmp_path / "mark").touch()
    outcome = execute_run(instance, create(instance, "signalled"))
    assert outcome == "CANCELED"
    assert attempts(tmp_path) == 1, "a retry policy revived a cancelled run"


def test_an_interrupted_run_is_canceled_if_its_client_asked(instance, tmp_path):
    run_id = create(instance, "signalled")
    outcome = execute_run(instance, run_id, cancel_requested=(tmp_path / "attempts").exists)
    assert outcome == "CANCELED"
    assert "PIPELINE_CANCELED" in events(instance, run_id)
    assert attempts(tmp_path) == 1


def test_an_interrupt_nobody_asked_for_is_a_failure(instance, tmp_path):
    assert execute_run(instance, create(instance, "signalled")) == "FAILURE"
    assert attempts(tmp_path) == 1


# --- the rest ----------------------------------------------------------------------------


def test_an_instance_is_opened_from_its_packed_form(instance):
    with open_instance(pack_instance(instance)) as again:
        assert again.root_directory == instance.root_directory


def test_dotenv_is_read_as_dagster_does(tmp_path):
    assert dotenv_variables(tmp_path) == {}
    (tmp_path / ".env").write_text('A=1\nexport B="two words"\n# C=3\n', "utf-8")
    assert dotenv_variables(tmp_path) == {"A": "1", "B": "two words"}


def test_a_rehearsal_leaves_no_thread_and_no_database_open_and_statements_compiled(tmp_path):
    """What a server has open when it forks, its workers would use at the same time."""
    recipe = make_project(tmp_path)
    with open_project(recipe) as workspace:
        instance = workspace.instance
        add_partitions(workspace.records, ["a.bag"])
        instance.report_runless_asset_event(dg.AssetMaterialization("bag", partition="a.bag"))
    code = (
        "import sys, threading\n"
        "from pathlib import Path\n"
        "from bagassets.defs.builds import pending_work; from bagassets.defs.records import sqlite_storage\n"
        "made, create = [], sqlite_storage.create_engine\n"
        "sqlite_storage.create_engine = lambda *args, **more: made.append(create(*args, **more)) or made[-1]\n"
        "pending_work.rehearse(Path(sys.argv[1]))\n"
        "links = [link.readlink() for link in Path('/proc/self/fd').iterdir() if link.is_symlink()]\n"
        "print(len(threading.enumerate()), sum(link.suffix == '.db' for link in links))\n"
        "print([len(engine._compiled_cache) > 0 for engine in made])\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(recipe)], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout) == (0, "1 0\n[True, True]\n"), done.stderr


def test_a_rehearsal_leaves_a_project_alone_that_has_no_database_yet(tmp_path):
    recipe = make_project(tmp_path)
    before = sorted(tmp_path.rglob("*"))
    rehearse(recipe)
    assert sorted(tmp_path.rglob("*")) == before


def test_preloading_starts_no_thread_and_opens_no_database():
    code = (
        "import sys, threading\n"
        "from pathlib import Path\n"
        "from bagassets.defs.launchers.run_worker import preload\n"
        "preload(['small_definitions'])\n"
        "databases = [file for file in Path('/proc/self/fd').glob('*') if '.db' in str(file.resolve())]\n"
        "print(threading.active_count(), databases, 'small_definitions' in sys.modules)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={"PYTHONPATH": f"{TESTS}:{TESTS.parent}"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.strip() == "1 [] True"
