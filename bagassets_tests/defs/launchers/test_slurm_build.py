"""Projects built by jobs of a real Slurm, with one command and no daemon."""

import hashlib
import json
import os
import re
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

import dagster as dg
import pytest
import yaml

from bagassets.defs.records.instances import open_instance
from bagassets.defs.runs.execution import failure_of
from bagassets.forkserver.client import Client
from bagassets.propose.project import dagster_home
from bagassets.recipe import load_recipe
from bagassets_tests.in_process import make_project
from bagassets_tests.series import write_parts
from bagassets_tests.slurm_cluster import NODES

WAIT_S = 120
pytestmark = pytest.mark.long
LAUNCHER = {"module": "bagassets.defs.slurm.launcher", "class": "SlurmRunLauncher"}


def command(recipe_file, *options):
    return [sys.executable, "-m", "bagassets", "build", "--recipe", str(recipe_file), *options]


def build(recipe_file, *options, status=0):
    done = subprocess.run(command(recipe_file, *options), capture_output=True, text=True, check=False)
    assert done.returncode == status, done.stdout + done.stderr
    return done


def use_slurm(recipe_file, **config):
    file = recipe_file.with_name("dagster.yaml")
    found = yaml.safe_load(file.read_text())
    found["run_launcher"] = {**LAUNCHER, "config": {"cpus": 2, **config}}
    file.write_text(yaml.safe_dump(found))


def home(recipe_file):
    return str(dagster_home(recipe_file, load_recipe(recipe_file)))


def runs(recipe_file, **filters):
    with open_instance(home(recipe_file)) as instance:
        return instance.get_runs(dg.RunsFilter(**filters))


def wait(condition, what, timeout_s=WAIT_S):
    deadline = time.monotonic() + timeout_s
    while not (found := condition()):
        assert time.monotonic() < deadline, what
        time.sleep(0.1)
    return found


def content(dataset):
    return {
        str(path.relative_to(dataset)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(dataset.rglob("*"))
        if path.is_file() and path.name != "dataset.lock.json"
    }


@pytest.fixture
def projects():
    """Recipes whose servers are ended."""
    made = []
    yield made
    for recipe_file in made:
        for client in Client.all_of(load_recipe(recipe_file).state):
            client.shutdown(grace_s=1.0)


@pytest.fixture
def project(tmp_path, slurm, projects):
    recipe_file = make_project(tmp_path / "p", ("a.bag", "b.mcap", "c.bag"))
    use_slurm(recipe_file, runs_per_job=2)
    projects.append(recipe_file)
    return recipe_file


def test_a_project_is_built_by_slurm_and_equals_the_one_built_here(project, projects, slurm):
    write_parts(project.parent / "bags" / "drive.bag", (0.7, 1.33), 2.0)
    done = build(project)
    assert "4 built" in done.stdout
    for key in ("a.bag", "drive.bag"):  # the second is in three files
        assert re.search(rf"{re.escape(key)}: Slurm job \d+ on n[12]", done.stderr)
    assert {run.tags["slurm/node"] for run in runs(project)} <= {"n1", "n2"}
    by_slurm = content(project.parent / "dataset")
    here = make_project(project.parent.with_name("here"), ())
    projects.append(here)
    shutil.copytree(project.parent / "bags", here.parent / "bags", dirs_exist_ok=True)
    build(here)
    assert content(here.parent / "dataset") == by_slurm
    assert "nothing to do" in build(project).stdout


def test_two_nodes_that_are_asked_for_the_same_at_once_agree(tmp_path, slurm, projects):
    keys = ("a.bag", "b.mcap")
    one = make_project(tmp_path / "one", keys)
    two = make_project(tmp_path / "two", ())
    shutil.copytree(one.parent / "bags", two.parent / "bags", dirs_exist_ok=True)
    for recipe_file in (one, two):
        recipe_file.write_text(f"{recipe_file.read_text()}store: {tmp_path / 'store'}\n")
        use_slurm(recipe_file)
        projects.append(recipe_file)
    # None begins before both wait, or one node could do the work of both, one after the other.
    set_nodes(slurm, "State=DRAIN", "Reason=test")
    try:
        processes = [start(recipe_file) for recipe_file in (one, two)]
        for recipe_file in (one, two):
            wait(lambda file=recipe_file: "slurm/job" in tags_of_runs(file), "its job waits")
    finally:
        set_nodes(slurm, "State=RESUME")
    for process in processes:
        out, err = process.communicate(timeout=WAIT_S)
        assert process.returncode == 0, out + err
    assert {run.tags["slurm/node"] for recipe_file in (one, two) for run in runs(recipe_file)} == {"n1", "n2"}
    assert content(one.parent / "dataset") == content(two.parent / "dataset")
    made = [json.loads(path.read_bytes())["action"] for path in (tmp_path / "store/actions").glob("*/*.json")]
    assert {action["step"] for action in made} >= {"inventory", "frames", "sweeps"}
    for recipe_file in (one, two):
        command_line = [sys.executable, "-m", "bagassets", "verify", "--recipe", str(recipe_file)]
        verified = subprocess.run(command_line, capture_output=True, text=True, check=False)
        assert verified.returncode == 0, verified.stdout + verified.stderr
    assert not list((tmp_path / "store/tmp").iterdir()), "nothing half-made is left"


def set_nodes(slurm, *settings):
    for node in NODES:
        slurm.ask("scontrol", "update", f"NodeName={node}", *settings)


def tags_of_runs(recipe_file):
    """The names of tags that all runs have; none if there is no run yet."""
    names = [set(run.tags) for run in runs(recipe_file)]
    return set.intersection(*names) if names else set()


def follow_output(process, pattern):
    for line in process.stderr:
        if re.search(pattern, line):
            return
    raise AssertionError(f"the build ended without {pattern}")


def start(recipe_file, **variables):
    return subprocess.Popen(
        command(recipe_file),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, **variables},
        # A shell has what it starts in the background ignore Ctrl-C.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # noqa: PLW1509  (no threads here)
    )


def test_ctrl_c_cancels_what_waits_in_slurm(project, slurm):
    use_slurm(project, options=["--begin=now+1hour"])
    process = start(project)
    follow_output(process, r"is queued \(BeginTime\)")
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=WAIT_S)
    assert process.returncode == 130, out + err
    assert {run.status.value for run in runs(project)} == {"CANCELED"}
    wait(lambda: slurm.ask("squeue", "--noheader") == "", "no job is left")


def test_jobs_survive_the_build_and_the_next_one_follows_them(project, slurm):
    # The three runs fill a job; until then it is waited for them, however busy the machine is.
    use_slurm(project, options=["--begin=now+1hour"], runs_per_job=3, gather_s=300.0)
    process = start(project)
    follow_output(process, r"is queued \(BeginTime\)")
    wait(lambda: "slurm/job" in tags_of_runs(project), "the job of each is known")
    (before,) = {run.tags["slurm/job"] for run in runs(project)}
    for client in Client.all_of(load_recipe(project).state):
        for job in client.status()["jobs"]:
            os.kill(job["process"]["pid"], signal.SIGKILL)
    process.kill()
    process.communicate()
    use_slurm(project)
    slurm.ask("scontrol", "update", f"JobId={before}", "StartTime=now")
    assert "3 built" in build(project).stdout
    by_recording = [run for run in runs(project) if "dagster/partition" in run.tags]
    assert [(run.status.value, run.tags["slurm/job"]) for run in by_recording] == [("SUCCESS", before)] * 3


def test_a_worker_that_was_declared_dead_and_goes_on_records_nothing(tmp_path, slurm, projects):
    # Long enough to be frozen before its end, however late that is noticed.
    project = make_project(tmp_path / "p", ("a.bag",), duration_s=60.0)
    use_slurm(project)
    projects.append(project)
    process = start(project)
    (run,) = wait(lambda: runs(project, statuses=[dg.DagsterRunStatus.STARTED]), "the run is at work")
    worker = json.loads(run.tags[".dagster/bagassets_worker"])
    stopped = [worker["process"]["pid"], worker["server"]["pid"]]
    freeze(project, stopped)
    slurm.stop(run.tags["slurm/node"], signal.SIGKILL)
    out, err = process.communicate(timeout=WAIT_S)
    assert "NODE_FAIL: its node failed" in out + err
    # A hit, if it was frozen when nearly all was made; what it had recorded before its end counts.
    assert re.search("1 (built|hit)", build(project).stdout)
    before = records(project)

    def recorded_late():
        return {name for name, run_id in records(project).items() if run_id == run.run_id != before.get(name)}

    os.kill(stopped[0], signal.SIGCONT)
    wait(lambda: has_ended(stopped[0]), "the worker ends")
    os.kill(stopped[1], signal.SIGCONT)
    wait(lambda: has_ended(stopped[1]), "its job ends")
    # Checking and writing are two moments: what the worker was just about to write counts as not recorded.
    late = recorded_late()
    assert len(late) <= 1
    with open_instance(home(project)) as instance:
        assert instance.get_run_by_id(run.run_id).status == dg.DagsterRunStatus.FAILURE
        said = failure_of(instance, instance.get_run_by_id(run.run_id))
    assert "so the worker records and publishes nothing more" in said
    launched = {one.run_id for one in runs(project)}
    build(project)
    # What was recorded late has the version that the other run gave it, so it may stay and need no run.
    assert len({one.run_id for one in runs(project)} - launched) <= len(late), "there is nothing else to do"
    assert recorded_late() <= late
    assert "nothing to do" in build(project).stdout
    verified = subprocess.run(
        [sys.executable, "-m", "bagassets", "verify", "--recipe", str(project)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert verified.returncode == 0, verified.stdout + verified.stderr


def freeze(recipe_file, pids):
    """Stop processes at a moment when they keep nobody from writing to a database of SQLite."""
    for _ in range(1000):
        for pid in pids:
            os.kill(pid, signal.SIGSTOP)
        if not any(is_locked(file) for file in Path(home(recipe_file)).rglob("*.db")):
            return
        for pid in pids:
            os.kill(pid, signal.SIGCONT)
        time.sleep(0.01)
    raise AssertionError("the databases are always locked")


def is_locked(database):
    with closing(sqlite3.connect(database, timeout=0, isolation_level=None)) as connection:
        try:
            connection.execute("BEGIN IMMEDIATE")
        except sqlite3.OperationalError:
            return True
        connection.execute("ROLLBACK")
        return False


def has_ended(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] in "ZX"
    except OSError:
        return True


def records(recipe_file):
    """The run that wrote the latest record of each asset."""
    with open_instance(home(recipe_file)) as instance:
        latest = {
            key.to_user_string(): instance.get_latest_materialization_event(key)
            for key in instance.get_asset_keys()
        }
        return {name: event.run_id for name, event in latest.items() if event is not None}
