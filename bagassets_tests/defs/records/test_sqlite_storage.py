"""One SQLite file for the events of all runs: nothing is lost, and projects of before go on."""

import re
import shutil
import sqlite3
import subprocess
import sys
import threading
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import closing
from datetime import UTC
from multiprocessing import get_context

import dagster as dg
import pytest
from alembic.script import ScriptDirectory
from sqlalchemy import create_engine, select

from bagassets.defs.dagster_private import AssetKeyTable, SqlEventLogStorage
from bagassets.defs.records import sqlite_storage
from bagassets.defs.records.events import event_database
from bagassets.defs.records.instances import open_instance
from bagassets.defs.records.sqlite_storage import ProjectEventLogStorage
from bagassets.propose.project import dagster_files
from bagassets.recipe import load_recipe
from bagassets_tests.in_process import build, make_project
from bagassets_tests.small_drive import write_drive

WRITERS, EVENTS = 8, 40
WAIT_S = 30.0


@pytest.fixture
def project(tmp_path):
    return make_project(tmp_path / "p", ("a.bag", "c.bag"))


@pytest.fixture
def old_project(project):
    """A project whose runs have files of their own."""
    home = project.parent
    text = (home / "dagster.yaml").read_text()
    storage = re.search(r"base_dir: (.*)\n", text)[1]
    (home / "dagster.yaml").write_text(
        re.sub(
            r"storage:\n.*?(?=local_artifact)",
            f"storage:\n  sqlite:\n    base_dir: {storage}\n",
            text,
            count=1,
            flags=re.DOTALL,
        )
    )
    with open_instance(str(home)) as instance:
        assert not isinstance(instance.event_log_storage, ProjectEventLogStorage)
    return project


def files(instance):
    return sorted(path.stem for path in event_database(instance).parent.glob("*.db"))


def logs(instance):
    """Run id -> kinds of its events, in order."""
    return {
        run.run_id: [entry.dagster_event.event_type_value for entry in instance.all_logs(run.run_id)]
        for run in instance.get_runs()
    }


def change_over(recipe_file):
    """As `bagassets init` does for a project that is there."""
    home = recipe_file.parent
    for name, text in dagster_files(home, load_recipe(recipe_file).state).items():
        (home / name).write_text(text)


def test_the_log_of_each_run_is_whole_and_all_are_in_one_file(project, monkeypatch):
    _, runs = build(project, monkeypatch)
    with open_instance(str(project.parent)) as instance:
        assert files(instance) == ["index"]
        assert len(logs(instance)) == len(runs) == 3
        for kinds in logs(instance).values():
            assert kinds.count("PIPELINE_START") == kinds.count("PIPELINE_SUCCESS") == 1
            assert kinds.count("ASSET_MATERIALIZATION") == kinds.count("ASSET_MATERIALIZATION_PLANNED") > 0


def test_a_project_of_before_changes_over_and_keeps_its_history(old_project, monkeypatch):
    build(old_project, monkeypatch)
    with open_instance(str(old_project.parent)) as instance:
        before = logs(instance)
        assert len(files(instance)) >= 4, "one each, and the common one"
    change_over(old_project)
    _, runs = build(old_project, monkeypatch)
    assert runs == [], "nothing is stale because of it"
    write_drive(old_project.parent / "bags/b.mcap", "mcap", duration_s=1.0)
    build(old_project, monkeypatch)
    with open_instance(str(old_project.parent)) as instance:
        after = logs(instance)
        assert {run_id: after[run_id] for run_id in before} == before
        new = set(after) - set(before)
        assert len(new) == 1
        assert not new & set(files(instance))
        found = instance.fetch_run_status_changes(dg.DagsterEventType.RUN_SUCCESS, limit=100).records
        assert {record.run_id for record in found} == set(after), "what sensors on runs see"
        for run_id in after:
            assert instance.get_run_stats(run_id).steps_succeeded > 0


def test_a_run_that_was_begun_before_the_change_goes_on_in_its_file(old_project):
    home = str(old_project.parent)
    with open_instance(home) as instance:
        run = instance.create_run_for_job(_job)
        instance.report_engine_event("before", run)
    change_over(old_project)
    with open_instance(home) as instance:
        instance.report_engine_event("after", run)
        materialized = dg.AssetMaterialization("own", partition="a.bag")
        instance.report_dagster_event(_materialization(run, materialized), run.run_id)
        messages = [entry.get_dagster_event().message for entry in instance.all_logs(run.run_id)]
        assert messages == ["before", "after", "made"]
        assert run.run_id in files(instance)
        assert instance.get_latest_materialization_event(dg.AssetKey("own")) is not None


def test_who_watches_a_run_hears_what_others_write(project):
    heard, enough = [], threading.Event()

    def hear(entry, _cursor):
        heard.append(entry.get_dagster_event().message)
        if len(heard) == 2:
            enough.set()

    home = str(project.parent)
    with open_instance(home) as instance, open_instance(home) as other:
        run, unseen = (instance.create_run_for_job(_job) for _ in range(2))
        instance.watch_event_logs(run.run_id, None, hear)
        other.report_engine_event("first", run)
        other.report_engine_event("of another run", unseen)
        other.report_engine_event("second", run)
        assert enough.wait(WAIT_S)
        instance.end_watch_event_logs(run.run_id, hear)
    assert heard == ["first", "second"]


def test_an_asset_is_recorded_with_what_finds_it_or_not_at_all(project, monkeypatch):
    tagged = dg.AssetMaterialization("frames", partition="a.bag", tags={"dagster/data_version": "1"})
    with open_instance(str(project.parent)) as instance:
        storage = instance.event_log_storage
        run = instance.create_run_for_job(_job)
        with monkeypatch.context() as patch:
            patch.setattr(storage, "_store_asset_event_tags", _fail)
            with pytest.raises(OSError, match="full"):
                instance.report_dagster_event(_materialization(run, tagged), run.run_id)
        assert storage.last_asset_event_id is None
        assert instance.all_logs(run.run_id) == []
        instance.report_dagster_event(_materialization(run, tagged), run.run_id)
        (record,) = instance.fetch_materializations(tagged.asset_key, limit=5).records
        assert storage.last_asset_event_id == record.storage_id
        with ThreadPoolExecutor() as pool:
            assert pool.submit(lambda: storage.last_asset_event_id).result() is None
        instance.report_engine_event("then", run)
        assert storage.last_asset_event_id is None


def test_the_latest_event_of_an_asset_is_noted_as_dagster_does(project, monkeypatch):
    def noted(instance, name):
        """Return what the table of assets has, after an asset was planned, observed and twice materialized."""
        key, run = dg.AssetKey(name), instance.create_run_for_job(_job)
        for version in ("1", "2"):
            made = dg.AssetMaterialization(key, partition="a.bag", tags={"dagster/data_version": version})
            instance.report_dagster_event(_materialization(run, made), run.run_id)
        instance.report_runless_asset_event(dg.AssetObservation(key, partition="a.bag"))
        (record,) = instance.get_asset_records([key])
        entry = record.asset_entry
        latest = entry.last_materialization_record
        assert latest.asset_materialization.tags == {"dagster/data_version": "2"}
        assert latest.run_id == entry.last_run_id == run.run_id
        (found,) = instance.fetch_materializations(key, limit=1).records
        return found.storage_id == entry.last_materialization_storage_id, latest.event_log_entry.timestamp > 0

    with open_instance(str(project.parent)) as instance:
        ours = noted(instance, "ours")
        dagsters = SqlEventLogStorage._store_asset_event
        monkeypatch.setattr(
            sqlite_storage._EventLogStorage, "_store_asset_event", lambda *args: dagsters(*args[:4])
        )
        assert noted(instance, "theirs") == ours == (True, True)


def test_the_latest_materialization_is_noted_as_dagster_spells_it_out(project):
    with open_instance(str(project.parent)) as instance:
        run, key = instance.create_run_for_job(_job), dg.AssetKey("frames")
        made = dg.AssetMaterialization(key, 'of "é"', {"n": 1.5}, "a.bag", tags={"dagster/data_version": "1"})
        for _ in range(2):  # of the first there is no row yet
            instance.report_dagster_event(_materialization(run, made), run.run_id)
        (record,) = instance.fetch_materializations(key, limit=1).records
        with instance.event_log_storage.index_connection() as connection:
            noted = connection.execute(
                select(AssetKeyTable).where(AssetKeyTable.c.asset_key == key.to_string())
            )
            (row,) = noted.mappings()
    assert row["last_materialization"] == dg.serialize_value(record)
    assert row["last_run_id"] == run.run_id
    noted_s = row["last_materialization_timestamp"].replace(tzinfo=UTC).timestamp()
    assert noted_s == pytest.approx(record.timestamp, abs=1e-6)  # in whole microseconds


def _fail(*_arguments):
    raise OSError("the disk is full")


def test_databases_stay_open_and_are_written_back_at_the_end_only(project):
    with open_instance(str(project.parent)) as instance:
        path = event_database(instance)
        log = path.with_name("index.db-wal")
        for number in range(2):
            instance.report_runless_asset_event(dg.AssetMaterialization("own", partition=str(number)))
            assert log.stat().st_size > 0, "closing the last connection writes the log back"
        with closing(sqlite3.connect(path)) as other:
            assert other.execute("SELECT count(*) FROM event_logs").fetchone()[0] == 2
    assert not log.exists()


def test_an_instance_is_opened_and_written_without_alembic_and_with_one_engine_for_a_file(
    project, monkeypatch
):
    home = str(project.parent)
    with open_instance(home):
        pass
    made = []
    monkeypatch.setattr(
        sqlite_storage, "create_engine", lambda url, **kw: made.append(url) or create(url, **kw)
    )
    monkeypatch.setattr(ScriptDirectory, "from_config", lambda *_: pytest.fail("migrations are read"))
    create = create_engine
    sqlite_storage._engine.cache_clear()
    for _ in range(2):
        with open_instance(home) as instance:
            instance.report_engine_event("an event", instance.create_run_for_job(_job))
            instance.schedule_storage.all_instigator_state()
    assert len(made) == len(set(made)) == 3


def test_a_database_that_is_replaced_is_opened_anew(project):
    """As by a build after the state folder was removed, while the web UI is up."""
    home = str(project.parent)
    with open_instance(home) as instance:
        instance.report_runless_asset_event(dg.AssetMaterialization("first"))
        shutil.rmtree(project.parent / ".bagassets")
        with open_instance(home) as other:
            other.report_runless_asset_event(dg.AssetMaterialization("second"))
        keys = {key.to_user_string() for key in instance.all_asset_keys()}
        assert keys == {"second"}


def test_threads_that_read_and_write_at_once_do_not_wait_for_each_other(project):
    with open_instance(str(project.parent)) as instance, ThreadPoolExecutor(20) as pool:
        run = instance.create_run_for_job(_job)
        storage = instance.event_log_storage
        with storage.index_connection() as held:
            held.exec_driver_sql("SELECT 1")
            list(pool.map(lambda number: instance.report_engine_event(str(number), run), range(40)))
        assert len(instance.all_logs(run.run_id)) == 40


def test_a_project_of_before_is_opened_with_files_that_stay_open_too(old_project):
    with open_instance(str(old_project.parent)) as instance:
        run = instance.create_run_for_job(_job)
        instance.report_engine_event("an event", run)
        assert files(instance) == [run.run_id, "index"]
        log = event_database(instance).with_name(f"{run.run_id}.db-wal")
        assert log.exists(), "closing the last connection writes it back"
        with dg.DagsterInstance.from_ref(instance.get_ref()) as again:  # as workers do
            assert type(again.event_log_storage) is type(instance.event_log_storage)
            assert len(again.all_logs(run.run_id)) == 1
    assert not log.exists()
    with dg.DagsterInstance.from_config(str(old_project.parent)) as plain:  # as Dagster's processes do
        assert type(plain.event_log_storage).__module__.startswith("dagster.")
        assert len(plain.all_logs(run.run_id)) == 1


@pytest.mark.long
def test_eight_processes_write_at_the_same_time_and_nothing_is_lost(project):
    home = str(project.parent)
    script = f"from bagassets_tests.defs.records.test_sqlite_storage import write_side_by_side; write_side_by_side({home!r})"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    run_ids = done.stdout.split()
    assert len(run_ids) == WRITERS
    with open_instance(home) as instance:
        for run_id in run_ids:
            messages = [entry.get_dagster_event().message for entry in instance.all_logs(run_id)]
            assert messages == [str(number) for number in range(EVENTS)]


def write_side_by_side(home):
    """In a process of its own, since it forks."""
    with open_instance(home):
        pass
    with ProcessPoolExecutor(WRITERS, get_context("fork")) as pool:
        print(*pool.map(write_events, [home] * WRITERS))


def write_events(home):
    with open_instance(home) as instance:
        run = instance.create_run_for_job(_job)
        for number in range(EVENTS):
            instance.report_engine_event(str(number), run)
        return run.run_id


@dg.job
def _job():
    pass


def _materialization(run, materialized):
    from dagster._core.events import StepMaterializationData

    return dg.DagsterEvent(
        dg.DagsterEventType.ASSET_MATERIALIZATION.value,
        run.job_name,
        event_specific_data=StepMaterializationData(materialized),
        message="made",
    )
