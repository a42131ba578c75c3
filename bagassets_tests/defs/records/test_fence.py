"""A run that was given up while its worker was at work records nothing that counts."""

import time

import dagster as dg
import pytest
from dagster._core.events import DagsterEvent, StepMaterializationData

from bagassets.base.errors import RunEndedError
from bagassets.base.lock_files import LockFile
from bagassets.defs.records.events import Records
from bagassets.defs.records.fence import Fence
from bagassets.defs.records.instances import open_instance
from bagassets.defs.records.naming import Naming
from bagassets.defs.records.run_step import RunStep
from bagassets.defs.runs import exclusive as exclusive_module
from bagassets.defs.runs.exclusive import RecordingLock, exclusive, holder_has_ended
from bagassets_tests.in_process import build, keys_of, make_project, states, survey


@pytest.fixture
def project(tmp_path, monkeypatch):
    recipe_file = make_project(tmp_path)
    build(recipe_file, monkeypatch)
    return recipe_file


def recorded_late(instance, run, asset):
    materialization = dg.AssetMaterialization(
        asset, partition="a.bag", tags={"dagster/data_version": "0" * 64, "dagster/code_version": "1"}
    )
    event = DagsterEvent(
        event_type_value="ASSET_MATERIALIZATION",
        job_name=run.job_name,
        event_specific_data=StepMaterializationData(materialization, []),
    )
    instance.report_dagster_event(event, run.run_id)


@pytest.mark.parametrize("ended", ["FAILURE", "CANCELED"])
def test_what_a_run_records_after_its_end_does_not_count(project, monkeypatch, ended):
    with open_instance(str(project.parent)) as instance:
        run = next(run for run in instance.get_runs() if "a.bag" in keys_of(run))
        report = instance.report_run_failed if ended == "FAILURE" else instance.report_run_canceled
        report(run, "Its node failed.")
        time.sleep(0.01)
        assert Records(instance, Naming("test")).of("ego_poses", "a.bag") is not None
        recorded_late(instance, run, "ego_poses")
        assert Records(instance, Naming("test")).of("ego_poses", "a.bag") is None
        assert Records(instance, Naming("test")).states(["ego_poses"])["ego_poses"] == {}
    pending = survey(project)
    assert states(pending, "a.bag")["ego_poses"] in {"missing", "record-only"}
    report, _ = build(project, monkeypatch)
    assert report.outcomes["a.bag"].result == "hit", "the artifact is in the store"
    assert survey(project).is_settled


def test_what_it_recorded_before_its_end_counts(project):
    with open_instance(str(project.parent)) as instance:
        run = next(run for run in instance.get_runs() if "a.bag" in keys_of(run))
        instance.report_run_failed(run, "Its node failed.")
    assert survey(project).is_settled


@pytest.fixture
def run():
    with dg.DagsterInstance.ephemeral() as instance:
        yield instance, instance.create_run_for_job(dg.GraphDefinition(name="g", node_defs=[]).to_job())


@pytest.fixture
def later(monkeypatch):
    """Stop the clock of fences, which a busy machine would have go on; return what moves it on by 3 s."""
    now_s = [1000.0]
    monkeypatch.setattr(time, "clock_gettime", lambda _clock: now_s[0])
    return lambda: now_s.append(now_s.pop() + 3.0)


def test_a_fence_closes_when_its_run_ends(run, later):
    instance, made = run
    fence = Fence(instance, made.run_id)
    instance.report_run_failed(made, "Its node failed.")
    fence.check()  # a moment ago it was open
    later()
    with pytest.raises(
        RunEndedError, match=f"run {made.run_id} ended as FAILURE while its worker was still at work"
    ):
        fence.check()


def test_a_worker_asks_before_its_first_recording_and_then_every_few_seconds(run, tmp_path, later):
    instance, made = run
    step, lock, other = (
        RunStep(instance, made.run_id),
        *(RecordingLock(folder=str(tmp_path)) for _ in range(2)),
    )
    with lock.hold(step, "a.bag"):
        instance.report_run_failed(made, "Its node failed.")
    with lock.hold(step, "b.bag"):  # a moment ago it was open
        pass
    with pytest.raises(RunEndedError), other.hold(step, "b.bag"):
        pass
    later()
    with pytest.raises(RunEndedError), lock.hold(step, "c.bag"):
        pass


def test_nobody_waits_for_a_run_that_has_ended(run, tmp_path):
    instance, made = run
    with exclusive(tmp_path, "a.bag", keep_waiting=lambda _: False, holder=made.run_id) as held:
        assert held
        assert not holder_has_ended(instance, tmp_path, "a.bag")
        instance.report_run_failed(made, "Its node failed.")
        assert holder_has_ended(instance, tmp_path, "a.bag")
    assert not holder_has_ended(instance, tmp_path, "b.bag")


def test_without_locks_runs_go_on(tmp_path, monkeypatch):
    def refuse(_self):
        raise OSError(95, "Operation not supported")

    monkeypatch.setattr(LockFile, "try_lock", refuse)
    with exclusive(tmp_path, "a.bag", keep_waiting=lambda _: True) as held:
        assert not held
    assert not exclusive_module._HELD
