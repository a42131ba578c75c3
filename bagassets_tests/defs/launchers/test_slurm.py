"""Runs executed by jobs of a real Slurm."""

import json
import os
import shutil
import signal
import threading
import time
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import dagster as dg
import pytest
import small_definitions

from bagassets.defs.launchers.slurm import commands as slurm_commands
from bagassets.defs.launchers.slurm.launcher import SlurmRunLauncher
from bagassets.defs.launchers.slurm.spool import Spool
from bagassets.defs.records.events import Records
from bagassets.defs.records.instances import open_instance
from bagassets.defs.records.naming import Naming
from bagassets.defs.runs.execution import CodeLocation, create_run
from bagassets.defs.runs.run_pool import RunPool

pytestmark = pytest.mark.once

TESTS = Path(__file__).parents[2]
LOCATION = CodeLocation("small_definitions", working_directory=str(TESTS))
WAIT_S = 60


def make_home(folder, **config):
    folder.mkdir(exist_ok=True)
    config = {"folder": str(folder / "slurm"), "gather_s": 0.8, "idle_s": 0.0, "cpus": 2, **config}
    (folder / "dagster.yaml").write_text(
        "telemetry: {enabled: false}\n"
        "run_launcher: {module: bagassets.defs.slurm.launcher, class: SlurmRunLauncher, "
        f"config: {json.dumps(config)}}}\n",
        "utf-8",
    )
    return folder


@pytest.fixture(autouse=True)
def steering(tmp_path, monkeypatch, slurm):
    monkeypatch.setenv("SMALL_DEFINITIONS", str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", str(TESTS.parent))
    return tmp_path


@pytest.fixture
def make_instance(tmp_path):
    opened = ExitStack()

    def make(**config):
        instance = opened.enter_context(open_instance(str(make_home(tmp_path / "home", **config))))
        instance.add_dynamic_partitions(small_definitions.recordings.name, ["drive", "walk", "third"])
        return instance

    with opened:
        yield make


def launch(instance, key, *assets, **tags):
    (run_id,) = launch_together(instance, [key], *assets, **tags)
    return run_id


def launch_together(instance, keys, *assets, **tags):
    """Launch runs of recordings one right after the other."""
    run_ids = [
        create_run(instance, assets, partition_key=key or None, location=LOCATION, tags=tags) for key in keys
    ]
    with RunPool(
        Records(instance, Naming("test")), 1, lambda _: None, Path(instance.root_directory) / "log", LOCATION
    ) as pool:
        workspace = pool._workspace.for_launcher()
        for run_id in run_ids:
            instance.launch_run(run_id, workspace)
    return run_ids


def wait(condition, what, timeout_s=WAIT_S):
    deadline = time.monotonic() + timeout_s
    while not (found := condition()):
        assert time.monotonic() < deadline, what
        time.sleep(0.1)
    return found


def ended(instance, run_id, timeout_s=WAIT_S):
    def run():
        found = instance.get_run_by_id(run_id)
        return found if found.is_finished else None

    return wait(run, "the run did not end", timeout_s)


def messages(instance, run_id):
    return "\n".join(entry.message for entry in instance.all_logs(run_id))


def test_runs_share_a_job_and_say_where_they_were(make_instance, slurm, steering):
    instance = make_instance(gather_s=4.0)  # a busy machine takes its time between two launches
    events = []
    with RunPool(Records(instance, Naming("test")), 5, events.append, steering / "log", LOCATION) as runs:
        runs.work([{"drive": ("first", "second")}, {"walk": ("broken",)}, {"": ("whole",)}])
    assert {key: one.problem for key, one in runs.ended.items()} == {
        "drive": None,
        "walk": "drive.bag: the recording is truncated; copy it again.",
        "": None,
    }
    tags = [instance.get_run_by_id(one.run_id).tags for one in runs.ended.values()]
    (job,) = {one["slurm/job"] for one in tags}
    (node,) = {one["slurm/node"] for one in tags}
    assert node in {"n1", "n2"}
    assert {one["bagassets/where"] for one in tags} == {f"Slurm job {job} on {node}"}
    (log,) = {one["slurm/log"] for one in tags}
    assert "ready after" in Path(log).read_text()
    wait(
        lambda: "COMPLETED" in slurm.ask("squeue", "--states=all", "--noheader", "--format=%T"),
        "it ends well",
    )


def test_a_job_that_has_none_left_takes_the_next_run(make_instance):
    # Two runs fill a job. One waits for a second for so long that only a job that is there already takes it, however
    # busy the machine is; and that job waits as long.
    patience_s = 300.0
    instance = make_instance(runs_per_job=2, gather_s=patience_s, idle_s=patience_s)
    full = [launch(instance, key, "first") for key in ("drive", "walk")]
    before, _ = (ended(instance, run_id, patience_s) for run_id in full)
    after = ended(instance, launch(instance, "drive", "second"), patience_s)
    assert after.is_success
    assert after.tags["slurm/job"] == before.tags["slurm/job"]
    assert after.tags["bagassets/where"] == before.tags["bagassets/where"]
    assert after.tags["slurm/log"] == before.tags["slurm/log"]


@pytest.mark.long
def test_a_run_at_work_and_one_that_waits_are_cancelled(make_instance, slurm, steering):
    # Two runs fill a job; until then it is waited for them, however busy the machine is.
    instance = make_instance(cpus=1, runs_per_job=2, gather_s=300.0)
    (steering / "hold").touch()
    at_work, waiting = launch_together(instance, ["drive", "walk"], "first")
    wait((steering / "spans").exists, "the first run begins")
    assert instance.run_launcher.terminate(waiting)
    assert instance.get_run_by_id(waiting).status == dg.DagsterRunStatus.CANCELED
    assert instance.run_launcher.terminate(at_work)
    assert ended(instance, at_work).status == dg.DagsterRunStatus.CANCELED
    wait(slurm.is_up, "the job has ended")
    assert not instance.run_launcher.terminate(at_work), "it has ended"


@pytest.mark.long
def test_a_job_that_nobody_needs_any_more_is_cancelled_while_it_waits(make_instance, slurm):
    instance = make_instance(options=["--begin=now+1hour"])
    run_id = launch(instance, "drive", "first")
    where = wait(
        lambda: (
            (found := instance.get_run_by_id(run_id).tags.get("bagassets/where", "")).endswith(")") and found
        ),
        "Slurm's reason is shown",
        20,
    )
    assert where.endswith("is queued (BeginTime)")
    run = instance.get_run_by_id(run_id)
    health = instance.run_launcher.check_run_worker_health(run)
    assert (health.status.value, health.msg) == ("RUNNING", f"{where}.")
    assert instance.run_launcher.terminate(run_id)
    wait(
        lambda: "CANCELLED" in slurm.ask("squeue", "--states=all", "--noheader", "--format=%T"),
        "it is cancelled",
    )


@pytest.mark.long
@pytest.mark.parametrize("what", ["cancelled", "preempted"])
def test_why_slurm_ended_a_job_is_why_its_run_failed(make_instance, slurm, steering, what):
    instance = make_instance()
    (steering / "hold").touch()
    run_id = launch(instance, "drive", "first")
    wait((steering / "spans").exists, "the run begins")
    job = instance.get_run_by_id(run_id).tags["slurm/job"]
    if what == "cancelled":
        slurm.ask("scancel", job)
        reason = "CANCELLED: somebody cancelled it (scancel)"
    else:
        slurm.ask(
            "sbatch", "--partition=urgent", "--nodes=2", "--exclusive", "--wrap=sleep 2", "--output=/dev/null"
        )
        reason = "PREEMPTED: it was stopped in favour of a job with a higher priority"
    run = ended(instance, run_id)
    assert run.status == dg.DagsterRunStatus.FAILURE
    assert f"Slurm job {job} on {run.tags['slurm/node']} ended as {reason}." in messages(instance, run_id)
    assert "end drive" not in (steering / "spans").read_text()


@pytest.mark.parametrize(
    ("config", "words"),
    [
        ({"partition": "no_such"}, "invalid partition specified: no_such"),
        ({"options": ["--no-such-option"]}, "unrecognized option '--no-such-option'"),
        ({"cpus": 64}, "More processors requested than permitted"),
        ({"python": "/no/such/python"}, "/no/such/python"),
    ],
)
def test_a_job_that_cannot_be_fails_its_run_with_slurms_words(make_instance, config, words):
    instance = make_instance(**config)
    run_id = launch(instance, "drive", "first")
    assert ended(instance, run_id).status == dg.DagsterRunStatus.FAILURE
    assert words in messages(instance, run_id)


def test_without_sbatch_the_run_fails(make_instance, monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    instance = make_instance()
    run_id = launch(instance, "drive", "first")
    assert ended(instance, run_id).status == dg.DagsterRunStatus.FAILURE
    assert "sbatch: not found; install Slurm's commands on this machine" in messages(instance, run_id)


@pytest.mark.long
def test_a_controller_that_does_not_answer_is_asked_again(make_instance, slurm, steering):
    instance = make_instance()
    slurm.stop("slurmctld")
    run_id = launch(instance, "drive", "first")
    wait(lambda: "Slurm takes no job at present" in messages(instance, run_id), "it says why it waits")
    health = instance.run_launcher.check_run_worker_health(instance.get_run_by_id(run_id))
    assert health.status.value == "RUNNING"
    slurm.start("slurmctld")
    assert ended(instance, run_id).status == dg.DagsterRunStatus.SUCCESS


@pytest.mark.long
def test_a_controller_that_never_answers_fails_the_run(make_instance, slurm):
    instance = make_instance(give_up_minutes=0.05)
    slurm.stop("slurmctld")
    run_id = launch(instance, "drive", "first")
    assert ended(instance, run_id).status == dg.DagsterRunStatus.FAILURE
    assert "The run could not be submitted to Slurm: " in messages(instance, run_id)
    assert "Unable to contact slurm controller" in messages(instance, run_id)


def refusing(folder, words, *, times):
    """An sbatch that refuses so often, since this Slurm has no accounting and hence no limits; then the real one."""
    count, real = folder / "refused", shutil.which("sbatch")
    script = f"""#!/bin/sh
if [ "$(cat '{count}' 2>/dev/null | wc -l)" -lt {times} ]; then
    echo >> '{count}'
    echo "{words}" >&2
    exit 1
fi
exec {real} "$@"
"""
    (folder / "bin").mkdir()
    (folder / "bin" / "sbatch").write_text(script)
    (folder / "bin" / "sbatch").chmod(0o755)
    return f"{folder}/bin:{os.environ['PATH']}"


@pytest.mark.long
@pytest.mark.parametrize(
    ("words", "status"),
    [
        ("sbatch: error: QOSMaxSubmitJobPerUserLimit", "SUCCESS"),
        ("sbatch: error: Invalid account or account/partition combination specified", "FAILURE"),
    ],
)
def test_a_limit_on_waiting_jobs_delays_a_run_and_a_wrong_account_fails_it(
    make_instance, slurm, steering, monkeypatch, words, status
):
    monkeypatch.setenv("PATH", refusing(steering, words, times=2))
    instance = make_instance()
    run_id = launch(instance, "drive", "first")
    assert ended(instance, run_id).status.value == status
    assert words in messages(instance, run_id)
    assert (steering / "refused").read_text().count("\n") == (2 if status == "SUCCESS" else 1)


@pytest.mark.long
def test_who_launches_many_runs_does_not_wait_for_slurm(make_instance, slurm, monkeypatch):
    """The daemon launches one run after another: it must not ask Slurm, nor look at those that wait, for each."""
    asked, looked = [], []
    real_run, real_waiting = slurm_commands._run, Spool.waiting

    def run(command, **options):
        asked.append((command[0], threading.current_thread()))
        return real_run(command, **options)

    def waiting(spool):
        looked.append(threading.current_thread())
        return real_waiting(spool)

    monkeypatch.setattr(slurm_commands, "_run", run)
    monkeypatch.setattr(Spool, "waiting", waiting)
    instance = make_instance(options=["--begin=now+1hour"], runs_per_job=25)
    keys = [f"recording {number}" for number in range(60)]
    instance.add_dynamic_partitions(small_definitions.recordings.name, keys)
    run_ids = launch_together(instance, keys, "first")
    wait(lambda: all("slurm/job" in run.tags for run in instance.get_runs()), "all are submitted")
    here = threading.current_thread()
    assert {thread for _, thread in asked if thread is here} == set()
    assert here not in looked
    jobs = {run.tags["slurm/job"] for run in instance.get_runs()}
    assert len(jobs) == [command for command, _ in asked].count("sbatch")
    assert len(jobs) < 10
    for run_id in run_ids:
        assert instance.run_launcher.terminate(run_id)
    wait(lambda: slurm.ask("squeue", "--noheader") == "", "their jobs are cancelled")


@pytest.mark.long
def test_a_killed_worker_fails_its_run_only(make_instance, steering):
    instance = make_instance()
    killed, other = launch(instance, "drive", "patient"), launch(instance, "walk", "first")
    wait((steering / "attempts").exists, "it begins")
    worker = json.loads(instance.get_run_by_id(killed).tags[".dagster/bagassets_worker"])["process"]["pid"]
    os.kill(worker, signal.SIGKILL)
    assert ended(instance, killed).status == dg.DagsterRunStatus.FAILURE
    assert "was killed by SIGKILL" in messages(instance, killed)
    assert ended(instance, other).status == dg.DagsterRunStatus.SUCCESS


def test_runs_that_are_not_ours_are_left_alone(make_instance):
    instance = make_instance()
    run_id = create_run(
        instance, ["whole"], location=LOCATION, tags={"slurm/job": "7", "slurm/log": "/no/log"}
    )
    run = instance.get_run_by_id(run_id)
    health = instance.run_launcher.check_run_worker_health(run)
    assert (health.status.value, health.msg) == ("RUNNING", "Executed by another program, which monitors it.")
    assert not instance.run_launcher.terminate(run_id)
    assert instance.run_launcher.get_run_worker_debug_info(run) is None


def test_a_run_asks_for_what_its_tags_say(make_instance, slurm):
    instance = make_instance(rules=[{"above_gb": -1.0, "time": "7"}], options=["--hold"])
    run_id = launch(instance, "", "whole", **{"slurm/partition": "urgent", "slurm/cpus": "1"})
    job = wait(lambda: instance.get_run_by_id(run_id).tags.get("slurm/job"), "it is submitted")
    asked = slurm.ask("squeue", f"--job={job}", "--noheader", "--format=%P|%C|%l")
    assert asked == "urgent|1|7:00"
    assert "Requeue=0" in slurm.ask("scontrol", "show", "job", job)


@pytest.mark.long
def test_a_dead_job_fails_the_runs_that_it_had_begun_and_the_others_get_another(
    make_instance, slurm, steering
):
    instance = make_instance(cpus=1, gather_s=4.0)  # a busy machine takes its time between two launches
    (steering / "hold").touch()
    begun, waiting = launch_together(instance, ["drive", "walk"], "first")
    spans = wait(
        lambda: (steering / "spans").exists() and (steering / "spans").read_text().split(), "one begins"
    )
    assert spans[1] == "drive"
    jobs = {
        run_id: wait(
            lambda run_id=run_id: instance.get_run_by_id(run_id).tags.get("slurm/job"), "its job is known"
        )
        for run_id in (begun, waiting)
    }
    assert jobs[begun] == jobs[waiting]
    slurm.ask(
        "sbatch", "--partition=urgent", "--nodes=2", "--exclusive", "--wrap=sleep 2", "--output=/dev/null"
    )
    assert ended(instance, begun).status == dg.DagsterRunStatus.FAILURE
    (steering / "hold").unlink()
    run = ended(instance, waiting)
    assert run.status == dg.DagsterRunStatus.SUCCESS
    assert run.tags["slurm/job"] != jobs[waiting]
    assert "It had not begun this run, which is submitted again." in messages(instance, waiting)


@pytest.mark.long
def test_a_node_that_fails_fails_its_runs_and_a_retry_succeeds_on_the_other(make_instance, slurm, steering):
    instance = make_instance()
    (steering / "hold").touch()
    run_id = launch(instance, "drive", "first")
    wait((steering / "spans").exists, "it begins")
    run = instance.get_run_by_id(run_id)
    job, node = run.tags["slurm/job"], run.tags["slurm/node"]
    slurm.stop(node, signal.SIGKILL)
    assert ended(instance, run_id).status == dg.DagsterRunStatus.FAILURE
    assert f"Slurm job {job} on {node} ended as NODE_FAIL: its node failed." in messages(instance, run_id)
    (steering / "hold").unlink()
    again = launch(instance, "drive", "first")
    retried = ended(instance, again)
    assert retried.status == dg.DagsterRunStatus.SUCCESS
    assert retried.tags["slurm/node"] != node


@pytest.mark.long
def test_a_job_that_slurm_has_forgotten_left_a_record(make_instance, slurm, steering):
    instance = make_instance()
    (steering / "hold").touch()
    run_id = launch(instance, "drive", "first")
    wait((steering / "spans").exists, "it begins")
    instance.run_launcher.dispose()  # as if the build were gone
    launcher_process = instance.get_run_by_id(run_id)
    job = launcher_process.tags["slurm/job"]
    slurm.ask("scancel", job)
    wait(slurm.is_up, "it has ended")
    slurm.forget_jobs()
    assert slurm.ask("squeue", "--states=all", "--noheader") == ""
    with open_instance(instance.root_directory) as later:
        assert run_id in later.run_launcher.end_lost_runs() or ended(later, run_id)
        assert later.get_run_by_id(run_id).status == dg.DagsterRunStatus.FAILURE
        assert f"Slurm job {job} on n" in messages(later, run_id)
        assert "was ended by a signal; Slurm has forgotten why" in messages(later, run_id)


@pytest.mark.long
def test_a_run_outlives_a_restart_of_the_controller(make_instance, slurm, steering):
    instance = make_instance()
    (steering / "hold").touch()
    run_id = launch(instance, "drive", "first")
    wait((steering / "spans").exists, "it begins")
    slurm.stop("slurmctld")
    (steering / "hold").unlink()
    assert ended(instance, run_id).status == dg.DagsterRunStatus.SUCCESS
    slurm.start("slurmctld")
    wait(slurm.is_up, "the job has ended")
    assert (
        instance.run_launcher.check_run_worker_health(instance.get_run_by_id(run_id)).status.value
        == "SUCCESS"
    )


@pytest.mark.long
def test_a_time_limit_is_why_a_run_failed(make_instance, steering):
    instance = make_instance(time="0:01")
    (steering / "hold").touch()
    run_id = launch(instance, "drive", "first")
    ended_run = wait(lambda: (run := instance.get_run_by_id(run_id)).is_finished and run, "it ends", 180)
    assert ended_run.status == dg.DagsterRunStatus.FAILURE
    assert "ended as TIMEOUT: it reached its time limit." in messages(instance, run_id)
    assert "Slurm job" in instance.run_launcher.get_run_worker_debug_info(ended_run)


@pytest.mark.long
@pytest.mark.parametrize(
    ("what", "words"),
    [
        ("folder", "does not see /no/such/store; mount it there"),
        ("version", "has other versions of libraries, which may give other bytes: numpy "),
    ],
)
def test_a_node_that_lacks_something_says_what(make_instance, monkeypatch, what, words):
    if what == "folder":
        monkeypatch.setattr(SlurmRunLauncher, "_spec", changed_spec(needs=("/no/such/store",)))
    else:
        monkeypatch.setattr(SlurmRunLauncher, "_spec", changed_spec(versions={"numpy": "0.1"}))
    instance = make_instance()
    run_id = launch(instance, "drive", "first")
    assert ended(instance, run_id).status == dg.DagsterRunStatus.FAILURE
    assert words in messages(instance, run_id)


def changed_spec(**changes):
    """What the machine that submits has, and no node."""
    original = SlurmRunLauncher._spec
    return lambda self, *about: replace(original(self, *about), **changes)
