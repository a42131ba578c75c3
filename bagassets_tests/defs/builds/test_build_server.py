"""Builds through a real fork server: the driver in a worker, interrupts, SQLite kept open."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import asdict
from functools import partial
from itertools import count
from pathlib import Path
from unittest.mock import Mock

import dagster as dg
import pytest
from dagster._core.storage.tags import GRPC_INFO_TAG

from bagassets.base import errors
from bagassets.base.errors import BagAssetsError, SelectionError
from bagassets.cli import early
from bagassets.cli.early import JOBS_PER_PROCESSOR
from bagassets.cli.remote import build_on_server
from bagassets.defs.records.instances import open_instance
from bagassets.defs.runs.exclusive import exclusive
from bagassets.defs.runs.worker_tag import RunWorker
from bagassets.engine.build_report import BagOutcome, BuildOptions, BuildReport, Event
from bagassets.engine.freshness.decide import plain_build
from bagassets.forkserver.client import Client, ServerRefusedError
from bagassets.forkserver.process import ProcessId
from bagassets.forkserver.tasks import find_server
from bagassets.recipe import load_recipe
from bagassets_tests.in_process import make_project, survey
from bagassets_tests.services import eventually
from bagassets_tests.small_drive import write_drive

pytestmark = [pytest.mark.xdist_group("build_server"), pytest.mark.once]
KEYS = ["a.bag", "b.mcap"]
QUALITIES = count(20)


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    recipe_file = make_project(tmp_path_factory.mktemp("server"), KEYS, duration_s=2.0)
    yield recipe_file
    for client in Client.all_of(load_recipe(recipe_file).state):
        client.shutdown(grace_s=1.0)


def command(recipe_file, *arguments):
    return [sys.executable, "-m", "bagassets", "build", "--recipe", str(recipe_file), *arguments]


def run(recipe_file, *arguments):
    return subprocess.run(command(recipe_file, *arguments), capture_output=True, text=True, check=False)


@pytest.fixture
def interruptible():
    """Shells have what they start in the background ignore Ctrl-C."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture
def built(project):
    done = run(project, "--json")
    assert done.returncode == 0, done.stderr
    return project


@pytest.fixture
def stale(project):
    """Both recordings are to be built and the server of their recipe is up, maybe as the test before left them."""
    client = find_server(project)
    if client is not None:
        client.close()
    if client is None or survey(project).todo.keys() != set(KEYS):
        assert run(project).returncode == 0
        text = re.sub(
            r"(/cam/image_raw)(, quality: \d+)?", rf"\1, quality: {next(QUALITIES)}", project.read_text()
        )
        project.write_text(text)
        assert run(project, "--bag", KEYS[0], "--select", "bag").returncode == 0  # a server for this recipe
    return project


def test_the_first_build_starts_a_server_that_the_next_one_uses(project):
    assert find_server(project) is None
    done = run(project)
    assert done.returncode == 0, done.stderr
    assert "2 built" in done.stdout
    assert "bagassets ui" in done.stdout
    client = find_server(project)
    assert client is not None
    servers = list(client.files.folder.glob("*.log"))
    assert servers == [client.files.log], "the server started early is the one that was asked for later"
    with client:
        (project.parent / "bags" / KEYS[0]).touch()
        events = []
        reported = build_on_server(client, project, BuildOptions(jobs=2), events.append, None)
        assert reported["counts"] == {
            "built": 0,
            "hit": 1,
            "fresh": 1,
            "skipped": 0,
            "failed": 0,
            "stopped": 0,
        }
        assert events == [], "no run"
        assert [row["recording"] for row in reported["summary"]] == KEYS
        (project.parent / "bags" / KEYS[0]).unlink()
        write_drive(project.parent / "bags" / KEYS[0], "ros1", duration_s=1.8)
        reported = build_on_server(client, project, BuildOptions(jobs=2), events.append, None)
        assert reported["counts"] == {
            "built": 1,
            "hit": 0,
            "fresh": 1,
            "skipped": 0,
            "failed": 0,
            "stopped": 0,
        }
        ran = [("started", KEYS[0]), ("done", KEYS[0]), ("started", ""), ("done", "")]
        assert [(e.kind, e.key) for e in events] == [("planned", ""), *ran]
        assert list(events[0].sizes) == [KEYS[0]]
        with pytest.raises(SelectionError, match="no such recording"):
            build_on_server(client, project, BuildOptions(bags=("nothing",)), events.append, None)


def test_the_command_line_imports_no_dagster_when_a_server_is_up(built):
    (built.parent / "bags" / KEYS[1]).touch()
    code = (
        f"import sys; sys.argv = {['bagassets', *command(built, '--json')[3:]]!r}; "
        "from bagassets.__main__ import main; status = main(); "
        "sys.exit('imported Dagster' if {'dagster', 'pydantic', 'numpy'} & set(sys.modules) else status)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["counts"]["hit"] == 1


def jobs_of(recipe_file):
    """Logs of builds."""
    with find_server(recipe_file) as client:
        return list(client.files.job_log("x").parent.glob("build-*"))


def test_the_server_begins_a_plain_build_before_the_command_line_is_imported(built):
    before = len(jobs_of(built))
    (built.parent / "bags" / KEYS[1]).touch()
    code = (
        f"import sys; sys.argv = {['bagassets', *command(built)[3:]]!r}\n"
        "from bagassets.cli import early\n"
        "hand_over = early.hand_over\n"
        "def seen(*args):\n"
        "    handed_over = hand_over(*args)\n"
        "    print('handed over' if handed_over else 'no server', 'click' in sys.modules)\n"
        "    return handed_over\n"
        "early.hand_over = seen\n"
        "from bagassets.__main__ import main\n"
        "sys.exit(main())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("handed over False\n")
    assert "1 hit, 1 fresh" in done.stdout
    assert len(jobs_of(built)) == before + 1, "it was begun once"


def test_the_server_is_started_before_the_command_line_is_imported(built):
    with find_server(built) as client:
        client.shutdown(grace_s=1.0)
    eventually(lambda: find_server(built) is None, "the server has ended")
    code = (
        f"import sys, time; sys.argv = {['bagassets', *command(built)[3:]]!r}\n"
        "from bagassets.cli import early\n"
        "begin_server, moments = early.begin_server, [time.monotonic()]\n"
        "def seen(*args):\n"
        "    print('click' in sys.modules, len(args))\n"
        "    from bagassets.cli import summary\n"
        "    told = summary.counts_line\n"
        "    def timed(report):\n"
        "        print('after', *(time.monotonic() - at for at in moments))\n"
        "        return told(report)\n"
        "    summary.counts_line = timed\n"
        "    moments.append(time.monotonic())\n"
        "    return begin_server(*args)\n"
        "early.begin_server = seen\n"
        "from bagassets.__main__ import main\n"
        "sys.exit(main())"
    )
    (built.parent / "bags" / KEYS[1]).touch()
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("False 2\n")
    said_s = float(re.search(r" in (\d+\.\d) s\n", done.stdout)[1])
    # Not by the clock of this process: a busy machine may have that one begin and end late.
    whole_s, since_it_started_s = map(
        float, re.search(r"^after (\S+) (\S+)$", done.stdout, re.MULTILINE).groups()
    )
    assert 0.6 * since_it_started_s < said_s < whole_s + 0.05, "the user has waited for the server, too"
    assert done.stdout.count("False") == 1, "it was started once"
    assert "1 hit, 1 fresh" in done.stdout
    with find_server(built) as client:
        assert list(client.files.folder.glob("*.log")) == [client.files.log]


def test_what_cannot_be_handed_over(project, built, monkeypatch):
    monkeypatch.setattr(early, "find_server", pytest.fail)
    assert early.hand_over(str(built), JOBS_PER_PROCESSOR * (os.cpu_count() or 1) + 1) is None
    monkeypatch.undo()
    assert early.hand_over(str(built.with_name("other.yaml")), 1) is None
    with monkeypatch.context() as patch:
        patch.setattr(Client, "submit", Mock(side_effect=TimeoutError))
        assert early.hand_over(str(built), 1) is None, "the command line reports it"
    assert plain_build(["build", "--jobs", "0"]) is None
    assert plain_build(["build", "-j", "3", "--recipe", "x"]) == ("x", 3)
    assert plain_build(["build"]) == ("recipe.yaml", None)


def test_a_wrong_recipe_is_reported_as_ever(built):
    text = built.read_text()
    try:
        built.write_text(text.replace("bags:", "bagz:"))
        done = run(built)
    finally:
        built.write_text(text)
    assert done.returncode == 1
    assert "recipe.yaml:3: bagz" in done.stderr


def test_an_interrupt_stops_cleanly_and_the_next_build_carries_on(stale):
    recipe = load_recipe(stale)
    # While this process holds the recording, its run cannot end.
    locks = recipe.state / "locks"
    with exclusive(locks, KEYS[0], keep_waiting=lambda _asked: True) as held:
        assert held
        process = subprocess.Popen(
            command(stale, "--jobs", "1"), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL),  # noqa: PLW1509  (no threads here)
        )  # fmt: skip
        seen = ""
        while f"start    {KEYS[0]}" not in seen:
            line = process.stderr.readline()
            assert line, seen
            seen += line
        os.kill(process.pid, signal.SIGINT)
        out, err = process.communicate(timeout=90)
    assert process.returncode == 130, (out, err)
    for key in KEYS:
        assert f"stopped {key}: the build was interrupted; the next one carries on" in out
    assert "2 stopped in" in out
    assert "(not updated)" in out
    with open_instance(str(stale.parent)) as instance:
        active = [dg.DagsterRunStatus.STARTED, dg.DagsterRunStatus.STARTING, dg.DagsterRunStatus.CANCELING]
        deadline = time.monotonic() + 20
        while instance.get_runs(dg.RunsFilter(statuses=active)) and time.monotonic() < deadline:
            time.sleep(0.1)
        assert not instance.get_runs(dg.RunsFilter(statuses=active))
    done = run(stale, "--json")
    assert done.returncode == 0, done.stderr
    reported = json.loads(done.stdout)
    assert (reported["counts"]["built"], reported["dataset"]["state"]) == (2, "updated")


class Interrupting:
    """Interrupts this process in a finalizer, where Python prints what is raised and goes on."""

    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)


@pytest.mark.usefixtures("interruptible")
def test_an_interrupt_is_not_lost_where_exceptions_are_ignored(stale):
    recipe = load_recipe(stale)

    def interrupt(event):
        if (event.kind, event.key) == ("started", KEYS[0]):
            Interrupting()

    with (
        exclusive(recipe.state / "locks", KEYS[0], keep_waiting=lambda _asked: True),
        find_server(stale) as client,
    ):
        report = build_on_server(client, stale, BuildOptions(jobs=1), interrupt, None)
    assert report["counts"]["stopped"] == 2


def workers_of(server):
    return [job for job in server.status()["jobs"] if job["function"].endswith("run_worker:execute")]


def test_a_killed_worker_fails_its_recording_and_the_build_goes_on(stale):
    recipe = load_recipe(stale)

    def kill_first(event):
        if (event.kind, event.key) == ("started", KEYS[0]):
            with find_server(stale) as other:
                while not (workers := workers_of(other)):
                    time.sleep(0.01)
                (worker,) = workers
                assert ProcessId.from_json(worker["process"]).send(signal.SIGKILL)

    # While this process holds the recording, its run cannot end.
    with (
        exclusive(recipe.state / "locks", KEYS[0], keep_waiting=lambda _asked: True),
        find_server(stale) as client,
    ):
        reported = build_on_server(client, stale, BuildOptions(jobs=1), kill_first, None)
    outcomes = {row["recording"]: row for row in reported["summary"]}
    assert outcomes[KEYS[0]]["result"] == "failed"
    assert "was killed by SIGKILL, maybe because the system ran out of memory" in json.dumps(reported)
    assert outcomes[KEYS[1]]["result"] == "built"
    done = run(stale, "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["counts"]["built"] == 1, (
        "a worker that was killed left no failure on record"
    )
    assert recipe.nuscenes.output.is_dir()


@pytest.mark.parametrize(
    ("end", "told"),
    [
        (
            {"event": "killed", "job": "1", "reason": "The worker was killed by SIGKILL."},
            "Its runs end within seconds",
        ),
        (
            ServerRefusedError("the fork server is gone."),
            "workers that survived it go on, maybe to the end of the build",
        ),
    ],
)
def test_a_lost_planner_or_server_is_no_riddle(end, told):
    client = Mock(submit=Mock(return_value="1"), wait=Mock(side_effect=[None, end]))
    with pytest.raises(BagAssetsError, match="was killed") as raised:
        build_on_server(client, Path("recipe.yaml"), BuildOptions(), lambda _: None, None)
    assert f"{told}, what is finished is kept, and the next build carries on." in str(raised.value)


@pytest.mark.parametrize(
    "kind",
    [one for one in vars(errors).values() if isinstance(one, type) and issubclass(one, BagAssetsError)]
    + [ServerRefusedError],
)
def test_an_error_for_users_is_the_same_error_here(kind):
    error = {
        "type": kind.__name__,
        "message": "/bags/a.bag: cannot be read; check the disk.\nIt is the disk's.",
        "is_for_users": True,
    }
    server = Mock(**{"wait.return_value": {"event": "finished", "job": "it", "exit": 1, "error": error}})
    with pytest.raises(BagAssetsError) as raised:
        build_on_server(server, Path("recipe.yaml"), BuildOptions(), lambda _: None, None, "it")
    expected = BagAssetsError if kind is ServerRefusedError else kind  # it is no error of a server here
    assert (type(raised.value), str(raised.value)) == (expected, error["message"])


@pytest.mark.long
@pytest.mark.parametrize("victim", ["planner", "server"])
def test_what_is_killed_says_what_becomes_of_the_build(built, victim):
    text = built.read_text()
    built.write_text(
        re.sub(r"/cam/image_raw(, quality: \d+)?", f"/cam/image_raw, quality: {30 + len(victim)}", text)
    )
    assert run(built, "--bag", KEYS[0], "--select", "bag").returncode == 0  # a server for this recipe
    # While this process holds the recording, its run cannot end, nor can the build.
    with (
        exclusive(load_recipe(built).state / "locks", KEYS[0], keep_waiting=lambda _asked: True),
        find_server(built) as client,
    ):
        process = client.process

        def kill(event):
            if event.kind == "started" and victim == "planner":
                with find_server(built) as other:
                    jobs = other.status()["jobs"]
                    (planner,) = [job for job in jobs if job["function"].endswith("build_project_in_worker")]
                    ProcessId.from_json(planner["process"]).send(signal.SIGKILL)
            elif event.kind == "started":
                process.send(signal.SIGKILL)

        with pytest.raises(BagAssetsError, match="and the next build carries on") as raised:
            build_on_server(client, built, BuildOptions(jobs=1), kill, None)
    assert "was killed" in str(raised.value)
    assert ("workers that survived it go on" in str(raised.value)) == (victim == "server")
    again = run(built, "--json")
    assert again.returncode == 0, again.stderr
    built.write_text(text)


def test_a_build_goes_through_the_launcher_that_dagster_yaml_names(tmp_path):
    """Dagster's own launcher executes each run in a process of a code server, which the build starts for it."""
    recipe_file = make_project(tmp_path, KEYS[:1])
    config = tmp_path / "dagster.yaml"
    text = config.read_text()
    start, end = text.index("run_launcher:"), text.index("run_coordinator:")
    launcher = "run_launcher: {module: dagster, class: DefaultRunLauncher}\n"
    config.write_text(text[:start] + launcher + text[end:])
    try:
        done = run(recipe_file, "--json")
        assert done.returncode == 0, done.stderr
        reported = json.loads(done.stdout)
        assert (reported["counts"]["built"], reported["dataset"]["state"]) == (1, "updated")
        with open_instance(str(tmp_path)) as instance:
            assert isinstance(instance.run_launcher, dg.DefaultRunLauncher)
            for made in instance.get_runs():
                assert GRPC_INFO_TAG in made.tags, "a code server executed it"
                assert RunWorker.of(made) is None
    finally:
        for client in Client.all_of(load_recipe(recipe_file).state):
            client.shutdown(grace_s=1.0)
    log = load_recipe(recipe_file).state / "code-server.log"
    assert log.is_file(), "what it writes is kept"


def test_reports_events_and_options_survive_the_way():
    options = BuildOptions(3, True, ("a", "b*"), ("frames",))
    assert BuildOptions.from_json(json.loads(json.dumps(asdict(options)))) == options
    assert BuildOptions.from_json({"jobs": 3}) == BuildOptions(3)
    event = Event("failed", "a", "because", {"a": 1})
    assert Event(**json.loads(json.dumps(asdict(event)))) == event
    report = BuildReport(
        outcomes={"a": BagOutcome("failed", "why", 1.5)},
        excluded={"x": "y"},
        removed=("z",),
        moved={"a": ("val", "train")},
        splits={"train": {"asked": 1.0, "is_far": False}},
        interrupted=True,
    )
    again = BuildReport.from_json(json.loads(json.dumps(report.as_json())))
    assert again.as_json() == report.as_json()
    assert again.outcomes == report.outcomes
    assert again.moved == report.moved
    assert not again.succeeded


def test_a_dataset_whose_recordings_could_not_be_stored_is_not_said_to_be_up_to_date(built):
    scratch = load_recipe(built).store_path / "tmp"
    text = re.sub(r"(topic: /cam/image_raw)(, quality: \d+)?", r"\1, quality: 33", built.read_text())
    built.write_text(text)
    scratch.rename(scratch.with_name("away"))
    scratch.write_text("in the way")
    try:
        done = run(built)
    finally:
        scratch.unlink()
        scratch.with_name("away").rename(scratch)
    assert done.returncode == 1, done.stdout
    assert "2 failed" in done.stdout
    assert "(not updated)" in done.stdout
    assert "(updated)" in run(built).stdout
