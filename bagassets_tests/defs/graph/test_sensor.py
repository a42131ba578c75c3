"""The sensor, scan by scan, in a real Dagster instance; and what it remembers in between."""

import datetime as dt
import os
import shutil
import sqlite3
from contextlib import closing
from dataclasses import replace

import dagster as dg
import pytest
from dagster._core.definitions.data_version import CachingStaleStatusResolver, StaleStatus
from dagster._core.events import DagsterEvent, DagsterEventType
from dagster._core.loader import LoadingContextForTest
from dagster._core.storage.tags import PARTITION_NAME_TAG

from bagassets.base.errors import RecordingError
from bagassets.defs.graph import sensor, sensor_scan
from bagassets.defs.graph.location import build_definitions
from bagassets.defs.graph.sensor_cursor import Cursor
from bagassets.defs.graph.sensor_scan import RULES, Scan
from bagassets.defs.records.events import Records, event_database
from bagassets.defs.records.instances import open_instance
from bagassets.defs.records.naming import Naming
from bagassets.defs.records.partitions import add_partitions
from bagassets.defs.records.workspace import Workspace
from bagassets.defs.runs.execution import create_run
from bagassets.defs.runs.orphaned_runs import UNTAKEN_S
from bagassets.formats.catalogue import recording_assets
from bagassets.formats.dataset_build import dataset_code_versions
from bagassets.recipe import load_recipe
from bagassets.recordings.digest import RecordingStat
from bagassets_tests.in_process import build, load_definitions, make_project
from bagassets_tests.small_drive import RECIPE, write_drive

pytestmark = pytest.mark.once

T0_S = 1_800_000_000.0
OLD_S = T0_S - 3600


# --- settling: what a change is dated by -------------------------------------------------


def stat(size=1, mtime_s=OLD_S):
    return RecordingStat((("a.bag", size, int(mtime_s * 1e9)),))


def test_a_new_recording_is_finished_once_it_has_been_the_same_for_long_enough():
    cursor = Cursor()
    assert cursor.settle({"a": stat()}, set(), 5, T0_S) == set()
    assert cursor.next_settled_s(5, set()) == T0_S + 5
    assert cursor.settle({"a": stat()}, set(), 5, T0_S + 4.9) == set()
    assert cursor.settle({"a": stat()}, set(), 5, T0_S + 5) == {"a"}


def test_a_growing_recording_starts_anew_with_each_change():
    cursor = Cursor()
    for second in range(20):
        assert cursor.settle({"a": stat(size=second)}, set(), 5, T0_S + second) == set()
    assert cursor.settle({"a": stat(size=19)}, set(), 5, T0_S + 24) == {"a"}


def test_a_change_is_dated_by_the_file_if_it_was_not_there_at_the_last_look():
    cursor = Cursor()
    cursor.settle({}, set(), 5, T0_S)
    assert cursor.settle({"a": stat(mtime_s=T0_S + 1)}, set(), 5, T0_S + 6) == {"a"}


@pytest.mark.parametrize("mtime_s", [OLD_S, T0_S + 3600])
def test_the_clock_of_a_file_server_that_is_wrong_is_not_believed(mtime_s):
    cursor = Cursor()
    cursor.settle({}, set(), 5, T0_S)
    assert cursor.settle({"a": stat(mtime_s=mtime_s)}, set(), 5, T0_S + 4) == set()
    assert cursor.settle({"a": stat(mtime_s=mtime_s)}, set(), 5, T0_S + 9) == {"a"}


def test_what_is_recorded_as_it_is_needs_no_watching_nor_room_in_the_cursor():
    cursor = Cursor()
    assert cursor.settle({"a": stat()}, {"a"}, 5, T0_S) == {"a"}
    assert cursor.watched == {}


def test_a_cursor_counts_how_often_the_same_was_asked_for():
    cursor = Cursor()
    assert cursor.tried("a", "what") == (0, 0.0)
    cursor.ask("a", "what", T0_S)
    cursor.ask("a", "what", T0_S + 60)
    assert cursor.tried("a", "what") == (2, T0_S + 60)
    assert cursor.tried("a", "something else") == (0, 0.0)
    cursor.ask("a", "something else", T0_S + 61)
    assert cursor.tried("a", "something else") == (1, T0_S + 61)
    assert cursor.runs == 3


def test_a_cursor_survives_being_written_down():
    cursor = Cursor(looked_s=1.5, busy_since_s=None, runs=3, quiet="abc", said="Well.")
    cursor.settle({"a": stat()}, set(), 5, T0_S)
    cursor.ask("b", "what", T0_S)
    assert Cursor.parse(cursor.text()) == cursor


@pytest.mark.parametrize("text", [None, "", "{}", "[]", "no json", '{"watched": {"a": 1}, "asked": {}}'])
def test_an_unreadable_cursor_is_as_good_as_none(text):
    assert Cursor.parse(text) == Cursor()


# --- scans -------------------------------------------------------------------------------


@pytest.fixture
def project(tmp_path):
    write_drive(tmp_path / "bags" / "a.bag", "ros1", duration_s=2.0)
    (tmp_path / "recipe.yaml").write_text(RECIPE.format(name="test", root="bags"))
    with dg.DagsterInstance.ephemeral() as instance:
        yield Project(tmp_path / "recipe.yaml", instance)


class Project:
    def __init__(self, recipe_file, instance):
        self.recipe_file, self.instance = recipe_file, instance
        self.bags = recipe_file.parent / "bags"
        self.cursor = Cursor()
        self.now_s = T0_S

    @property
    def recipe(self):
        return load_recipe(self.recipe_file)

    @property
    def datasets(self):
        """What a run that updates the datasets makes."""
        return [dg.AssetKey(name) for name in dataset_code_versions(self.recipe)]

    @property
    def live(self):
        return Records(self.instance, Naming(self.recipe.name)).live()

    def scan(self, after_s=1.0):
        """Scan anew, as a tick does; return the runs asked for as key -> request."""
        self.now_s += after_s
        scan = Scan(Workspace(recipe_file=str(self.recipe_file)).on(self.instance), self.cursor)
        requests = scan.scan(self.now_s)
        self.cursor = Cursor.parse(self.cursor.text())
        return {request.partition_key or "": request for request in requests}

    def execute(self, request):
        job = build_definitions(self.recipe_file).resolve_implicit_global_asset_job_def()
        return job.execute_in_process(
            partition_key=request.partition_key,
            instance=self.instance,
            asset_selection=list(request.asset_selection),
            raise_on_error=False,
        )

    def build_project(self):
        for _ in range(5):
            requests = self.scan()
            if not requests:
                return
            for request in requests.values():
                assert self.execute(request).success
        raise AssertionError("there is always something to do")

    def settle_for(self, seconds):
        text = self.recipe_file.read_text()
        self.recipe_file.write_text(text.replace("settle_s: 0", f"settle_s: {seconds}"))


def test_a_new_recording_is_registered_and_asked_for_once_it_has_settled(project):
    project.settle_for(30)
    assert project.scan() == {}
    assert project.live == frozenset()
    assert project.cursor.said == "1 recording; waiting for a.bag to settle."
    (request,) = project.scan(after_s=30).values()
    assert request.partition_key == "a.bag"
    assert request.asset_selection == [
        dg.AssetKey(name) for name in ("bag", *recording_assets(project.recipe).names)
    ]
    assert request.tags["why"] == "new recording"
    assert project.live == {"a.bag"}
    assert project.scan() == {}  # asked for already


def test_the_dataset_is_asked_for_when_the_recordings_are_done_and_then_nothing(project):
    (recording,) = project.scan().values()
    assert project.execute(recording).success
    (dataset,) = project.scan().values()
    assert dataset.asset_selection == project.datasets
    assert project.execute(dataset).success
    assert project.scan() == {}
    assert project.cursor.said == "1 recording; up to date."
    assert (project.cursor.asked, project.cursor.watched) == ({}, {})


def stale(project):
    """Return what Dagster's own markers call stale."""
    graph = build_definitions(project.recipe_file).resolve_asset_graph()
    resolver = CachingStaleStatusResolver(project.instance, graph, LoadingContextForTest(project.instance))
    partitions = {key: [None] for key in graph.materializable_asset_keys}
    partitions |= {key: project.live for key in partitions if graph.get(key).is_partitioned}
    status = {(key, part): resolver.get_status(key, part) for key in partitions for part in partitions[key]}
    return {which for which, is_now in status.items() if is_now != StaleStatus.FRESH}


def test_the_markers_of_dagster_are_gone_when_the_sensor_has_nothing_to_do(project):
    project.build_project()
    assert stale(project) == set()
    shutil.copy(project.bags / "a.bag", project.bags / "c.bag")
    (project.bags / "c.bag").open("ab").close()
    project.build_project()
    assert stale(project) == set()
    (project.bags / "c.bag").unlink()
    project.build_project()
    assert stale(project) == set()


def test_nothing_is_planned_when_nothing_has_changed(project, monkeypatch):
    project.build_project()
    assert project.cursor.quiet

    def planned(*_args, **_options):
        raise AssertionError("the plan was made again")

    monkeypatch.setattr("bagassets.defs.graph.sensor_scan.planner_of", planned)
    assert project.scan() == {}
    assert project.cursor.said == "1 recording; up to date."
    project.instance.wipe_assets([dg.AssetKey("frames")])
    with pytest.raises(AssertionError, match="the plan was made again"):
        project.scan()


def test_where_nothing_has_changed_no_recording_is_looked_for(project, monkeypatch):
    project.build_project()
    assert project.cursor.quiet
    with monkeypatch.context() as patch:
        patch.setattr("bagassets.defs.records.workspace.discover", None)
        assert project.scan() == {}
    (project.bags / "notes.txt").touch()
    monkeypatch.setattr("bagassets.defs.records.workspace.discover", None)
    with pytest.raises(TypeError):
        project.scan()


def test_what_a_backfill_targets_goes_once_that_has_ended(project, monkeypatch):
    shutil.copy(project.bags / "a.bag", project.bags / "c.bag")
    project.build_project()
    (project.bags / "c.bag").unlink()
    held = lambda _instance, keys: dict.fromkeys(keys, "why")
    with monkeypatch.context() as patch:
        patch.setattr("bagassets.defs.graph.sensor_scan.held_by_backfills", held)
        project.build_project()
        project.scan()
        assert "c.bag" in project.live
    project.scan()
    assert "c.bag" not in project.live


@pytest.mark.parametrize("change", ["recording", "recipe", "wipe"])
def test_what_changes_is_asked_for_alone(project, change):
    write_drive(project.bags / "b.mcap", "mcap", duration_s=2.0)
    project.build_project()
    if change == "recording":
        write_drive(project.bags / "b.mcap", "mcap", duration_s=2.5)
    elif change == "recipe":  # the code location still has the recipe of before
        text = project.recipe_file.read_text()
        project.recipe_file.write_text(text.replace("min_length_s: 0.5", "keyframe_hz: 1.0"))
    else:
        project.instance.wipe_assets([dg.AssetKey("nuscenes_tables")])
    requests = project.scan()
    assert set(requests) == ({"b.mcap"} if change == "recording" else {"a.bag", "b.mcap"})


def test_a_removed_recording_loses_its_partition_and_the_dataset_its_scenes(project):
    shutil.copy(project.bags / "a.bag", project.bags / "z.bag")
    write_drive(project.bags / "b.mcap", "mcap", duration_s=2.0)
    project.build_project()
    assert project.live == {"a.bag", "b.mcap", "z.bag"}
    (project.bags / "b.mcap").unlink()
    (request,) = project.scan().values()
    assert project.live == {"a.bag", "z.bag"}
    assert request.asset_selection == project.datasets


def test_all_recordings_at_once_are_dropped_after_a_while_as_a_disk_may_come_back(project):
    write_drive(project.bags / "b.mcap", "mcap", duration_s=2.0)
    project.build_project()
    away = project.bags.with_name("away")
    project.bags.rename(away)
    project.bags.mkdir()
    assert project.scan() == {}
    assert "is its disk mounted?" in project.cursor.said
    assert project.live == {"a.bag", "b.mcap"}
    project.bags.rmdir()
    away.rename(project.bags)
    assert project.scan(after_s=50) == {}
    project.bags.rename(away)
    project.bags.mkdir()
    assert project.scan(after_s=50) == {}
    assert project.live == {"a.bag", "b.mcap"}
    assert set(project.scan(after_s=61)) == {""}
    assert project.live == frozenset()


def test_recordings_in_a_folder_that_cannot_be_read_stay_and_others_go_on(project, monkeypatch):
    write_drive(project.bags / "day" / "b.mcap", "mcap", duration_s=2.0)
    project.build_project()
    scandir = os.scandir

    def refuse(path):
        if str(path).endswith("/day"):
            raise PermissionError(13, "Permission denied", str(path))
        return scandir(path)

    monkeypatch.setattr(os, "scandir", refuse)
    shutil.copy(project.bags / "a.bag", project.bags / "z.bag")
    project.build_project()
    assert project.live == {"a.bag", "day__b.mcap", "z.bag"}
    (project.bags / "a.bag").unlink()
    (project.bags / "z.bag").unlink()
    project.scan(after_s=100)
    project.scan(after_s=100)
    assert project.live == {"day__b.mcap"}
    monkeypatch.undo()
    project.build_project()
    assert project.live == {"day__b.mcap"}


def test_the_last_recording_goes_at_once(project):
    project.build_project()
    (project.bags / "a.bag").unlink()
    assert set(project.scan()) == {""}
    assert project.live == frozenset()


def test_a_recording_that_comes_back_as_it_was_is_recorded_anew_without_work(project):
    write_drive(project.bags / "b.mcap", "mcap", duration_s=2.0)
    project.build_project()
    away = project.bags.parent / "b.mcap"
    (project.bags / "b.mcap").rename(away)
    project.build_project()
    away.rename(project.bags / "b.mcap")
    (request,) = project.scan().values()
    assert project.live == {"a.bag", "b.mcap"}
    events = project.execute(request).all_events
    made = [e.event_specific_data.materialization for e in events if e.is_step_materialization]
    assert {m.metadata["cached"].value for m in made if "cached" in m.metadata} == {True}


def test_a_failure_on_record_is_reported_and_not_tried_again(project):
    (project.bags / "broken.bag").write_bytes(b"#ROSBAG V2.0\n" + b"x" * 100)
    for request in project.scan().values():
        assert project.execute(request).success == (request.partition_key == "a.bag")
    (dataset,) = project.scan().values()
    assert dataset.asset_selection == project.datasets
    assert project.execute(dataset).success
    assert project.scan(after_s=1000) == {}
    assert project.cursor.said == "2 recordings; failed: broken.bag."
    shutil.copy(project.bags / "a.bag", project.bags / "broken.bag")
    assert set(project.scan()) == {"broken.bag"}


def make_run(project, key, status):
    tags = {PARTITION_NAME_TAG: key} if key else {}
    job = build_definitions(project.recipe_file).resolve_implicit_global_asset_job_def()
    selection = None if key else frozenset(project.datasets)
    return project.instance.create_run_for_job(job, tags=tags, status=status, asset_selection=selection)


def test_a_run_that_was_lost_is_asked_for_again_after_a_while(project):
    assert set(project.scan()) == {"a.bag"}
    make_run(project, "a.bag", dg.DagsterRunStatus.FAILURE)
    assert project.scan(after_s=RULES.retry_s - 2) == {}
    assert set(project.scan(after_s=3)) == {"a.bag"}


def test_a_run_that_somebody_cancelled_is_not_asked_for_again(project):
    assert set(project.scan()) == {"a.bag"}
    make_run(project, "a.bag", dg.DagsterRunStatus.CANCELED)
    assert project.scan(after_s=10 * RULES.retry_s) == {}
    (project.bags / "a.bag").touch()
    assert set(project.scan()) == {"a.bag"}


def scan_all(project, after_s=1.0):
    """Scan anew; return all requests."""
    project.now_s += after_s
    scan = Scan(Workspace(recipe_file=str(project.recipe_file)).on(project.instance), project.cursor)
    return scan.scan(project.now_s)


def launch_job(project, request, status=None):
    """Do what the daemon does with a request for several recordings; `status` is what became of it."""
    job = build_definitions(project.recipe_file).resolve_job_def(request.job_name)
    if status is not None:
        run = project.instance.create_run_for_job(job, run_config=request.run_config, status=status)
        return run.run_id
    return job.execute_in_process(run_config=request.run_config, instance=project.instance).run_id


def test_small_recordings_share_a_run(project):
    for name in ("b.bag", "c.bag", "d.bag"):
        shutil.copy(project.bags / "a.bag", project.bags / name)
    (request,) = scan_all(project)
    assert request.job_name == "build_recordings"
    assert request.partition_key is None
    assert request.tags["why"] == "4 recordings; a.bag: new recording"
    assert scan_all(project) == [], "asked for already"
    running = launch_job(project, request, dg.DagsterRunStatus.STARTED)
    assert scan_all(project, 100) == []
    assert project.cursor.said == "4 recordings; waiting for 1 run."
    project.instance.delete_run(running)
    launch_job(project, request)
    (request,) = scan_all(project)
    assert request.asset_selection == project.datasets
    assert project.execute(request).success
    assert scan_all(project) == []
    assert stale(project) == set()


def test_those_of_a_shared_run_that_somebody_cancelled_are_not_asked_for_again(project):
    for name in ("b.bag", "c.bag", "d.bag"):
        shutil.copy(project.bags / "a.bag", project.bags / name)
    (request,) = scan_all(project)
    launch_job(project, request, dg.DagsterRunStatus.CANCELED)
    assert scan_all(project, 10 * RULES.retry_s) == []
    (project.bags / "a.bag").touch()
    assert set(project.scan()) == {"a.bag"}


def test_more_recordings_than_one_run_takes_get_several(project, monkeypatch):
    monkeypatch.setattr(sensor_scan, "RULES", replace(RULES, most_per_run=4, most_runs=2))
    for number in range(11):
        shutil.copy(project.bags / "a.bag", project.bags / f"{number:02}.bag")
    first = [
        set(request.run_config["ops"]["build_each"]["config"]["recordings"]) for request in scan_all(project)
    ]
    assert [len(keys) for keys in first] == [4, 4]
    (rest,) = scan_all(project)
    assert len(set.union(*first, rest.run_config["ops"]["build_each"]["config"]["recordings"])) == 12


def test_of_a_recording_that_was_only_touched_bag_alone_is_asked_for(project):
    project.build_project()
    (project.bags / "a.bag").touch()
    request = project.scan()["a.bag"]
    assert request.asset_selection == [dg.AssetKey("bag")]
    assert project.execute(request).success
    assert project.scan() == {}
    assert stale(project) == set()


def test_a_recording_with_a_run_is_left_alone(project):
    make_run(project, "a.bag", dg.DagsterRunStatus.STARTED)
    assert project.scan() == {}
    assert project.cursor.said == "1 recording; waiting for 1 run."


def test_no_more_runs_are_asked_for_than_are_worked_off(project, monkeypatch):
    monkeypatch.setattr(sensor_scan, "RULES", replace(RULES, most_runs=2))
    for name in ("b.bag", "c.bag", "d.bag"):
        shutil.copy(project.bags / "a.bag", project.bags / name)
    make_run(project, "a.bag", dg.DagsterRunStatus.STARTED)
    assert set(project.scan()) == {"b.bag"}
    make_run(project, "b.bag", dg.DagsterRunStatus.STARTED)
    assert project.scan() == {}
    assert project.live == {"a.bag", "b.bag", "c.bag", "d.bag"}


def test_the_dataset_waits_for_runs_but_not_for_ever(project):
    project.build_project()
    shutil.copy(project.bags / "a.bag", project.bags / "b.bag")
    (recording,) = project.scan().values()
    assert project.execute(recording).success
    make_run(project, "long.bag", dg.DagsterRunStatus.STARTED)
    assert project.scan() == {}
    assert project.scan(after_s=30) == {}
    (request,) = project.scan(after_s=31).values()
    assert request.asset_selection == project.datasets


def test_a_second_run_of_the_dataset_waits_for_the_first(project):
    for request in project.scan().values():
        assert project.execute(request).success
    make_run(project, "", dg.DagsterRunStatus.STARTED)
    assert project.scan() == {}
    assert project.scan(after_s=100) == {}


# --- ticks -------------------------------------------------------------------------------


def tick(project, definitions=None):
    definitions = definitions or build_definitions(project.recipe_file)
    context = dg.build_sensor_context(
        instance=project.instance,
        definitions=definitions,
        resources={"workspace": Workspace(recipe_file=str(project.recipe_file))},
    )
    return definitions.resolve_sensor_def("recordings")(context)


def test_a_tick_waits_for_a_recording_that_is_about_to_settle(project, monkeypatch):
    monkeypatch.setattr(sensor, "PAUSE_S", 0.05)
    project.settle_for(0.3)
    result = tick(project)
    assert [request.partition_key for request in result.run_requests] == ["a.bag"]
    assert result.run_requests[0].job_name == "recordings_and_datasets"


def test_a_tick_does_not_wait_for_one_that_takes_longer(project, monkeypatch):
    monkeypatch.setattr(sensor.time, "sleep", lambda _: pytest.fail("it waited"))
    project.settle_for(30)
    result = tick(project)
    assert not result.run_requests
    assert result.skip_reason.skip_message == "1 recording; waiting for a.bag to settle."


def test_a_recording_that_goes_during_a_look_is_no_failure(project, monkeypatch):
    monkeypatch.setattr(sensor, "PAUSE_S", 0.0)
    planner_of, calls = sensor_scan.planner_of, []

    def plan(*args, **options):
        calls.append(args)
        if len(calls) == 1:
            raise RecordingError("a.bag: cannot be read (No such file or directory); was it removed?")
        return planner_of(*args, **options)

    monkeypatch.setattr(sensor_scan, "planner_of", plan)
    assert [request.partition_key for request in tick(project).run_requests] == ["a.bag"]


def test_a_missing_bag_root_fails_the_tick_with_a_sentence(project, monkeypatch):
    monkeypatch.setattr(sensor, "PAUSE_S", 0.0)
    project.bags.rename(project.bags.with_name("elsewhere"))
    with pytest.raises(dg.Failure, match=r"recipe\.yaml:3: bags\.root: there is no folder"):
        tick(project)


def test_a_wrong_recipe_fails_the_tick_with_a_sentence(project):
    definitions = build_definitions(project.recipe_file)
    project.recipe_file.write_text(project.recipe_file.read_text().replace("rigs:", "riggs:"))
    with pytest.raises(dg.Failure, match=r"recipe\.yaml:5: .*riggs"):
        tick(project, definitions)


def test_the_sensor_is_on_by_default(project):
    assert (
        build_definitions(project.recipe_file).resolve_sensor_def("recordings").default_status
        == dg.DefaultSensorStatus.RUNNING
    )


# --- runs that were left behind ----------------------------------------------------------


@pytest.fixture
def left_behind(tmp_path, monkeypatch):
    """A project whose daemon was killed when it had marked the run of `a.bag` as starting: recipe, instance, run."""
    recipe_file = make_project(tmp_path)
    monkeypatch.setenv("BAGASSETS_RECIPE", str(recipe_file))
    load_definitions(recipe_file)
    with open_instance(str(tmp_path)) as instance:
        recipe = load_recipe(recipe_file)
        add_partitions(Records(instance, Naming(recipe.name)), ["a.bag"])
        run_id = create_run(instance, ["bag", *recording_assets(recipe).names], partition_key="a.bag")
        starting = DagsterEvent(DagsterEventType.PIPELINE_STARTING.value, "__ASSET_JOB", message="to start")
        instance.report_dagster_event(starting, run_id)
        yield recipe_file, instance, run_id


def make_old(instance, run_id):
    then = str(dt.datetime.now(dt.UTC).replace(tzinfo=None) - dt.timedelta(seconds=UNTAKEN_S + 1))
    path = event_database(instance).parent.parent / "runs.db"
    with closing(sqlite3.connect(path)) as runs:
        runs.execute("UPDATE runs SET update_timestamp = ? WHERE run_id = ?", (then, run_id))
        runs.commit()


def test_a_run_left_behind_no_longer_keeps_the_sensor_from_asking(left_behind):
    recipe_file, instance, run_id = left_behind
    scan = Scan(Workspace(recipe_file=str(recipe_file)).on(instance), Cursor())
    assert [scan.scan(T0_S + second) for second in (0, 1)] == [[], []], "it may be starting"
    make_old(instance, run_id)
    (request,) = scan.scan(T0_S + 2)
    assert request.partition_key == "a.bag"
    assert instance.get_run_by_id(run_id).status == dg.DagsterRunStatus.FAILURE


def test_a_build_reports_runs_left_behind(left_behind, monkeypatch):
    recipe_file, instance, run_id = left_behind
    make_old(instance, run_id)
    report, _ = build(recipe_file, monkeypatch)
    assert report.counts()["built"] == 1
    assert instance.get_run_by_id(run_id).status == dg.DagsterRunStatus.FAILURE
