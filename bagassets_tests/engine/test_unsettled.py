"""A run that did not end well leaves nothing behind, once all is as it was: no red partition, and no check that is missing."""

import time

import dagster as dg
import pytest

from bagassets.assets.frames import FrameExtractor
from bagassets.base.errors import DecodeError
from bagassets.defs.builds import pending_work
from bagassets.defs.graph import checks as graph_checks
from bagassets.defs.graph import several
from bagassets.defs.graph.location import build_definitions
from bagassets.defs.records.batches import batch_config
from bagassets.defs.records.instances import open_instance
from bagassets.defs.records.naming import Naming
from bagassets.defs.runs.execution import failure_of
from bagassets.engine.unsettled import Unsettled
from bagassets.recipe import load_recipe
from bagassets_tests.defs.graph.test_batches import KEYS, checks, make, outcomes, partitions
from bagassets_tests.defs.graph.test_sensor import Project, make_run
from bagassets_tests.in_process import build, survey

pytestmark = pytest.mark.once

BROKEN = "d1.bag"


def edit(recipe_file, old, new):
    recipe_file.write_text(recipe_file.read_text().replace(old, new))


def test_recordings_are_noted_whatever_their_names(tmp_path):
    unsettled, keys = Unsettled(tmp_path), {"a.bag", "tour/ä b.bag", "x" * 400}
    assert unsettled.noted() == frozenset()
    for key in keys:
        unsettled.add(key)
        unsettled.add(key)
    assert Unsettled(tmp_path).noted() == keys
    (tmp_path / "unsettled" / ".half").write_text("a.b")
    unsettled.discard("a.bag")
    unsettled.discard("never.bag")
    assert unsettled.noted() == keys - {"a.bag"}


def test_a_folder_that_cannot_be_written_does_not_matter(tmp_path):
    unsettled = Unsettled(tmp_path / "gone")
    unsettled.add("a.bag")
    unsettled.discard("a.bag")
    assert unsettled.noted() == frozenset()


def test_checks_that_a_worker_did_not_come_to_are_made_up_for(tmp_path, monkeypatch):
    recipe_file = make(tmp_path, KEYS)

    def killed(workspace, recording, *arguments):
        results = run_checks(workspace, recording, *arguments)
        yield next(results)
        if recording.key == BROKEN:
            raise SystemExit("killed")
        yield from results

    run_checks = graph_checks.run_checks
    with monkeypatch.context() as patch:
        patch.setattr(graph_checks, "run_checks", killed)
        report, _ = build(recipe_file, monkeypatch, jobs=1)
    assert outcomes(report) == {key: "failed" if key == BROKEN else "built" for key in KEYS}
    assert states(recipe_file, BROKEN) == {"fresh", "record-only"}
    assert survey(recipe_file).todo.keys() == {BROKEN}
    report, _ = build(recipe_file, monkeypatch, jobs=1)
    assert outcomes(report) == {key: "hit" if key == BROKEN else "fresh" for key in KEYS}
    with pending_work.open_project(recipe_file) as workspace:
        instance = workspace.instance
        recorded = checks(instance, recipe_file)
    assert {name for name, key in recorded if key == BROKEN} == {
        name for name, key in recorded if key != BROKEN
    }
    assert_nothing_is_left(recipe_file, monkeypatch)


def test_a_worker_whose_run_was_given_up_leaves_no_note(tmp_path, monkeypatch):
    recipe_file = make(tmp_path, KEYS[:1])
    build(recipe_file, monkeypatch, jobs=1)

    def given_up(step, *_):
        step.instance.report_run_failed(step.instance.get_run_by_id(step.run_id), "Its node failed.")

    monkeypatch.setattr(several, "note_begun", given_up)
    names = Naming(load_recipe(recipe_file).name)
    with open_instance(str(tmp_path)) as instance:
        job = build_definitions(recipe_file).resolve_job_def(names.batch_job)
        config = batch_config({KEYS[0]: ("frames",)}, names)
        result = job.execute_in_process(run_config=config, instance=instance, raise_on_error=False)
        assert "was still at work" in str(failure_of(instance, instance.get_run_by_id(result.run_id)))
    assert_nothing_is_left(recipe_file, monkeypatch)


@pytest.mark.parametrize("keys", [KEYS[:2], KEYS], ids=["a run each", "a shared run"])
def test_a_recipe_that_was_wrong_for_a_while_leaves_no_failed_partition(tmp_path, monkeypatch, keys):
    recipe_file = make(tmp_path, keys)
    build(recipe_file, monkeypatch, jobs=1)
    edit(recipe_file, "/cam/image_raw", "/cam/image_raw, quality: 33")
    with monkeypatch.context() as patch:
        patch.setattr(FrameExtractor, "add", _refuse)
        report, _ = build(recipe_file, monkeypatch, jobs=1)
    assert set(outcomes(report).values()) == {"failed"}
    assert survey(recipe_file).todo == {}  # what failed is left alone
    edit(recipe_file, ", quality: 33", "")
    assert failed(recipe_file) == set(keys)
    assert outcomes(build(recipe_file, monkeypatch, jobs=1)[0]) == dict.fromkeys(keys, "hit")
    assert failed(recipe_file) == set()
    assert_nothing_is_left(recipe_file, monkeypatch)


def test_a_recording_that_takes_no_part_any_more_is_forgotten(tmp_path, monkeypatch):
    recipe_file = make(tmp_path, KEYS)
    with monkeypatch.context() as patch:
        patch.setattr(FrameExtractor, "add", _refuse)
        build(recipe_file, monkeypatch, jobs=1)
    (tmp_path / "bags" / KEYS[0]).unlink()
    edit(recipe_file, "settle_s: 0", "settle_s: 0, min_duration_s: 1.25")
    build(recipe_file, monkeypatch, jobs=1)
    unsettled = Unsettled(load_recipe(recipe_file).state)
    assert survey(recipe_file).plan.bags[KEYS[1]].skipped
    assert not unsettled.noted() & {*KEYS[:3]}


@pytest.fixture
def watched(tmp_path):
    """A project of one recording that is up to date, and its sensor."""
    recipe_file = make(tmp_path, KEYS[:1])
    with open_instance(str(tmp_path)) as instance:
        project = Project(recipe_file, instance)
        project.now_s = time.time()  # runs that have ended are found by the time of the database
        project.build_project()
        yield project


def test_a_run_of_the_sensor_that_failed_leaves_no_failed_partition(watched, monkeypatch):
    edit(watched.recipe_file, "/cam/image_raw", "/cam/image_raw, quality: 33")
    with monkeypatch.context() as patch:
        patch.setattr(FrameExtractor, "add", _refuse)
        assert not watched.execute(watched.scan()[KEYS[0]]).success
    assert KEYS[0] not in watched.scan()
    edit(watched.recipe_file, ", quality: 33", "")
    assert failed(watched.recipe_file) == {KEYS[0]}
    watched.build_project()
    assert failed(watched.recipe_file) == set()
    assert_nothing_is_left(watched.recipe_file, monkeypatch)


def fail_a_run(project):
    """Report a run of the recording as failed, which notes the time; that of a new run is in whole seconds."""
    run = make_run(project, KEYS[0], dg.DagsterRunStatus.STARTED)
    project.instance.report_run_failed(run)


def test_a_run_that_failed_is_made_up_for_whoever_launched_it(watched):
    fail_a_run(watched)
    request = watched.scan()[KEYS[0]]
    assert "did not end well" in request.tags["why"]
    assert watched.scan() == {}
    assert watched.execute(request).success
    assert [watched.scan(after_s) for after_s in (1, 1, 600)] == [{}, {}, {}]
    assert Unsettled(watched.recipe.state).noted() == frozenset()


def test_a_shared_run_after_one_that_failed_is_enough(watched):
    fail_a_run(watched)
    names = Naming(watched.recipe.name)
    job = build_definitions(watched.recipe_file).resolve_job_def(names.batch_job)
    config = batch_config({KEYS[0]: ("inventory", "frames")}, names)
    assert job.execute_in_process(run_config=config, instance=watched.instance).success
    assert KEYS[0] not in watched.scan()
    assert Unsettled(watched.recipe.state).noted() == frozenset()


def states(recipe_file, key):
    return {state.state for state in survey(recipe_file).plan.bags[key].assets.values()}


def failed(recipe_file):
    """Return the recordings that the web UI shows as failed."""
    with pending_work.open_project(recipe_file) as workspace:
        instance = workspace.instance
        names = workspace.assets.names
        return set().union(*(partitions(instance, recipe_file, name, "failed") for name in names))


def assert_nothing_is_left(recipe_file, monkeypatch):
    assert Unsettled(load_recipe(recipe_file).state).noted() == frozenset()
    report, runs = build(recipe_file, monkeypatch, jobs=1)
    assert runs == []
    assert set(outcomes(report).values()) == {"fresh"}


def _refuse(*_arguments):
    raise DecodeError("as it was told to")
