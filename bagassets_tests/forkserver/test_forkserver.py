"""The fork server: jobs, ends of all kinds, one server per stamp, and its own end."""

import json
import os
import re
import resource
import selectors
import shutil
import signal
import socket
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from itertools import count
from pathlib import Path
from types import SimpleNamespace

import pytest

from bagassets.base.errors import BagAssetsError
from bagassets.base.lock_files import is_locked
from bagassets.forkserver.client import Client, ServerRefusedError, ServerStart
from bagassets.forkserver.connection import Connection
from bagassets.forkserver.process import ProcessId
from bagassets.forkserver.server import Server
from bagassets.forkserver.server_files import ServerFiles
from bagassets.forkserver.spec import ServerSpec
from bagassets.forkserver.tasks import server_spec

pytestmark = pytest.mark.once

JOBS = "forkserver_jobs"
TESTS = Path(__file__).parents[1]
WAIT_S = 60


def eventually(condition, what="it happens"):
    deadline = time.monotonic() + WAIT_S
    while not (found := condition()):
        assert time.monotonic() < deadline, f"waited {WAIT_S} s until {what}"
        time.sleep(0.02)
    return found


def spec_in(folder, **options):
    defaults = {"modules": (JOBS,), "paths": (str(TESTS),), "preload": f"{JOBS}:preload"}
    return ServerSpec(folder, **(defaults | options)).located()


@pytest.fixture
def client(tmp_path):
    with Client.ensure(spec_in(tmp_path / "state")) as client:
        yield client
        with suppress(ServerRefusedError):  # the test ended it
            client.shutdown(grace_s=0.0)


def end_of(client, job):
    """The event that reports the end of a job."""
    while True:
        event = client.wait(WAIT_S)
        assert event is not None, "the job ends"
        if event["job"] == job and event["event"] in {"finished", "killed"}:
            return event


def await_start(client, key="started"):
    event = client.wait(WAIT_S)
    assert event is not None
    return event["note"][key]


# --- jobs --------------------------------------------------------------------------------


def test_a_worker_returns_json_and_reports_on_the_way(client):
    job = client.submit(f"{JOBS}:add", {"x": 1, "y": 2}, label="sum")
    assert client.wait(WAIT_S) == {"event": "note", "job": job, "note": {"half": 1}}
    assert client.wait(WAIT_S) == {"event": "finished", "job": job, "exit": 0, "result": 3}
    assert client.files.job_log("sum").read_text() == "adding\n"


def test_an_event_that_comes_as_the_time_runs_out_is_returned(client):
    client.submit(f"{JOBS}:add", {"x": 1, "y": 2}, label="sum")
    deadline = time.monotonic() + WAIT_S
    while (event := client.wait(0.0)) is None:
        assert time.monotonic() < deadline, "the job reports"
    assert event["event"] == "note"


def test_a_worker_has_the_clients_surroundings_and_a_session_of_its_own(client, monkeypatch, tmp_path):
    monkeypatch.setenv("SURROUNDING", "of the client")
    monkeypatch.chdir(tmp_path)
    job = client.submit(f"{JOBS}:surroundings", {}, label="s")
    assert end_of(client, job)["result"] == {"env": "of the client", "cwd": str(tmp_path), "leader": True}


@pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="needs /proc")
def test_a_worker_inherits_none_of_the_servers_files(client):
    with Client.connect(client.files) as other:
        other.submit(f"{JOBS}:sleep", {}, label="another job")
        files = end_of(client, client.submit(f"{JOBS}:open_files", {}, label="files"))["result"]
    sockets = [name for name in files if name.startswith("socket:")]
    assert len(sockets) == 1, "its own line to the server"
    assert not [name for name in files if name.endswith(".lock") or "eventpoll" in name]


@pytest.mark.parametrize("line", [b"[]", b"3", b"null", b"hello"])
def test_what_is_no_message_costs_its_connection_and_no_other(client, line):
    with Client.connect(client.files) as other:
        other._socket.setblocking(True)
        other._socket.sendall(line + b"\n")
        assert other._socket.recv(1) == b""
    job = client.submit(f"{JOBS}:add", {"x": 1, "y": 2}, label="sum")
    assert end_of(client, job)["result"] == 3


def test_nobody_waits_for_the_process_of_a_job_that_is_done(client):
    job = client.submit(f"{JOBS}:end_slowly", {}, label="slow")
    pid = end_of(client, job)["result"]
    os.kill(pid, 0)  # it is still there
    assert client.status()["jobs"] == []
    assert not client.cancel(job)
    assert client.wait(0.1) is None, "it is reported once"
    os.kill(pid, signal.SIGKILL)
    again = client.submit(f"{JOBS}:add", {"x": 1, "y": 2}, label="sum")
    assert end_of(client, again)["result"] == 3
    assert client.wait(0.1) is None, "even when its process ends"


def test_a_client_that_goes_as_it_is_sent_its_result_does_no_harm():
    server, ours, theirs = object.__new__(Server), *socket.socketpair()
    job = SimpleNamespace(
        id="1", label="x", is_done=True, lines=SimpleNamespace(is_closed=False), listen=list,
        describe_end=lambda _: {"event": "finished", "job": "1"}, cancel=None,
    )  # fmt: skip
    with selectors.DefaultSelector() as selector:
        owner = Connection(ours, selector, server._on_message, server._on_close)
        server._jobs, server._owners, server._connections = {"1": job}, {"1": owner}, {owner}
        theirs.close()
        server._on_note(job)
    assert (server._owners, server._connections) == ({}, set())


def test_an_error_is_reported_with_its_text(client):
    event = end_of(client, client.submit(f"{JOBS}:fail", {}, label="f"))
    assert event["exit"] == 1
    assert (event["error"]["type"], event["error"]["message"]) == ("ValueError", "no such luck")
    assert "ValueError: no such luck" in client.files.job_log("f").read_text()


def test_an_unknown_function_is_named(client):
    event = end_of(client, client.submit(f"{JOBS}:nothing", {}, label="n"))
    assert f"{JOBS}:nothing" in event["error"]["message"]


def test_an_exit_without_result_is_an_error(client):
    event = end_of(client, client.submit(f"{JOBS}:leave", {}, label="leave"))
    assert event["exit"] == 3
    assert "exit code 3" in event["error"]["message"]


def test_a_killed_worker_is_reported_before_the_client_hears_of_it(client, tmp_path):
    report = tmp_path / "report"
    args = {"report": str(report)}
    job = client.submit(f"{JOBS}:sleep", args, label="k", on_lost=f"{JOBS}:write_down")
    await_start(client)
    (found,) = client.status()["jobs"]
    assert ProcessId.from_json(found["process"]).send(signal.SIGKILL)
    event = end_of(client, job)
    assert (event["event"], event["signal"]) == ("killed", "SIGKILL")
    assert "out of memory" in event["reason"]
    assert report.read_text() == f"{{'started': True}} {event['reason']}"


def test_a_failed_worker_is_reported_too(client, tmp_path):
    report = tmp_path / "report"
    job = client.submit(f"{JOBS}:fail", {"report": str(report)}, label="f", on_lost=f"{JOBS}:write_down")
    assert end_of(client, job)["exit"] == 1
    assert "no such luck" in report.read_text()


def test_jobs_run_side_by_side(client, tmp_path):
    go = tmp_path / "go"
    jobs = {client.submit(f"{JOBS}:wait", {"until": str(go)}, label=f"w{n}") for n in range(5)}
    for _ in jobs:
        await_start(client)
    go.touch()
    assert {client.wait(WAIT_S)["job"] for _ in jobs} == jobs


def test_a_job_asked_for_once_runs_once(client, tmp_path):
    args = {"file": str(tmp_path / "file")}
    first = client.submit(f"{JOBS}:touch", args, label="one", once=True)
    assert end_of(client, first)["exit"] == 0
    assert client.submit(f"{JOBS}:touch", args, label="one", once=True) == ""
    assert (tmp_path / "file").read_text() == "x"


# --- cancelling --------------------------------------------------------------------------


def test_cancelling_interrupts_and_says_why(client):
    job = client.submit(f"{JOBS}:stop_politely", {}, label="c")
    await_start(client)
    assert client.cancel(job)
    assert end_of(client, job)["result"] == [True]
    assert not client.cancel(job)


def test_an_interrupt_is_not_lost_in_a_finalizer(client):
    """Where Python prints it and goes on, as in a callback of an import: a build would go on to its end."""
    event = end_of(client, client.submit(f"{JOBS}:be_interrupted_in_a_finalizer", {}, label="i"))
    assert event["error"]["type"] == "KeyboardInterrupt"


def test_another_client_may_cancel(client):
    job = client.submit(f"{JOBS}:sleep", {}, label="c")
    await_start(client)
    for other in Client.all_of(client.files.state_folder):
        assert other.cancel(job)
    assert end_of(client, job)["signal"] == "SIGTERM"


def test_a_worker_that_does_not_stop_is_killed_with_its_children(client):
    job = client.submit(f"{JOBS}:be_stubborn", {}, label="b")
    child = ProcessId.of(await_start(client, "child"))
    assert child.is_alive()
    client.cancel(job, grace_s=0.2)
    event = end_of(client, job)
    assert event["signal"] == "SIGKILL"
    assert "cancelled" in event["reason"]
    eventually(lambda: not child.is_alive(), "the child is gone")


def test_jobs_end_with_their_client_unless_detached(client, tmp_path):
    with Client.connect(client.files) as passing:
        for label in ("bound", "free"):
            args = {"until": str(tmp_path / "go")}
            passing.submit(f"{JOBS}:wait", args, label=label, detached=label == "free")
    eventually(lambda: [job["label"] for job in client.status()["jobs"]] == ["free"])


# --- finding and starting ----------------------------------------------------------------


def test_a_second_client_finds_the_server(client, tmp_path):
    with Client.ensure(spec_in(tmp_path / "state")) as other:
        assert other.process == client.process


def test_clients_that_start_at_once_share_one_server(tmp_path):
    spec = spec_in(tmp_path)
    with ThreadPoolExecutor(4) as pool:
        clients = list(pool.map(lambda _: Client.ensure(spec), range(4)))
    assert len({client.process for client in clients}) == 1
    clients[0].shutdown()
    for client in clients:
        client.close()


def write_module(folder, name, text):
    folder.mkdir(exist_ok=True)
    (folder / f"{name}.py").write_text(text, "utf-8")
    return {"modules": (JOBS, name), "paths": (str(TESTS), str(folder))}


def test_changed_code_starts_a_server_and_the_old_one_drains(tmp_path):
    options = write_module(
        tmp_path / "code", "edited_module", "VERSION = 1\n\n\ndef version(args):\n    return VERSION\n"
    )
    go = tmp_path / "go"
    with Client.ensure(spec_in(tmp_path, **options)) as old:
        busy = old.submit(f"{JOBS}:wait", {"until": str(go)}, label="busy")
        await_start(old)
        write_module(tmp_path / "code", "edited_module", "def version(args):\n    return 'second'\n")
        with Client.ensure(spec_in(tmp_path, **options)) as new:
            assert new.process != old.process
            job = new.submit("edited_module:version", {}, label="v")
            assert end_of(new, job)["result"] == "second"
            with pytest.raises(ServerRefusedError):
                old.submit("edited_module:version", {}, label="v")
            go.touch()
            assert end_of(old, busy)["result"] == "waited"
            eventually(lambda: not old.process.is_alive(), "the old server is gone")
            new.shutdown()


def test_a_module_that_another_imports_counts_as_code(tmp_path):
    """Such a module, say of a plug-in, is not covered by the stamp; the server itself remembers it."""
    write_module(tmp_path / "plug_in", "plugged_in", "VALUE = 1\n")
    inserting = f"import sys\nsys.path.append({str(tmp_path / 'plug_in')!r})\nimport plugged_in\n"
    options = write_module(tmp_path / "code", "importing_module", inserting)
    with Client.ensure(spec_in(tmp_path, **options)) as old:
        write_module(tmp_path / "plug_in", "plugged_in", "VALUE = 'another'\n")
        with Client.ensure(spec_in(tmp_path, **options)) as new:
            assert new.files == old.files, "the stamps are the same"
            assert new.process != old.process
            new.shutdown()


def test_the_stamp_covers_what_counts(tmp_path, monkeypatch):
    recipe = tmp_path / "recipe.yaml"
    recipe.write_text("name: a\n", "utf-8")

    def stamp():
        return spec_in(tmp_path, recipe=recipe).stamp()

    monkeypatch.delenv("OPENBLAS_CORETYPE", raising=False)
    seen = [stamp()]
    monkeypatch.setenv("SOME_VARIABLE", "1")
    assert stamp() == seen[0], "other variables reach each worker, so they do not count"
    monkeypatch.setenv("OPENBLAS_CORETYPE", "Haswell")
    seen.append(stamp())
    recipe.write_text("name: b\n", "utf-8")
    seen.append(stamp())
    (tmp_path / ".env").write_text("OPENBLAS_CORETYPE=Zen\n", "utf-8")
    seen.append(stamp())
    monkeypatch.setenv("OPENBLAS_CORETYPE", "overridden by .env")
    assert stamp() == seen[-1]
    assert len(set(seen)) == len(seen)
    recipe.write_text("name: a\n", "utf-8")
    (tmp_path / ".env").unlink()
    monkeypatch.delenv("OPENBLAS_CORETYPE")
    assert stamp() == seen[0], "a change taken back finds the first server again"


def test_a_step_may_wait_until_no_job_is_at_work(tmp_path):
    file = tmp_path / "go"
    preload = f"{JOBS}:preload_with_a_pause"
    with Client.ensure(spec_in(tmp_path / "state", preload=preload)) as client:
        numbers = count()

        def done(pause_s=0.0):
            time.sleep(pause_s)
            job = client.submit(f"{JOBS}:steps_done", {}, label=f"steps-{next(numbers)}")
            return end_of(client, job)["result"]

        job = client.submit(f"{JOBS}:wait", {"until": str(file)}, label="at work")
        eventually(done, "the first step is done")
        assert done(pause_s=1.0) == ["at once"], "even after more than a quiet moment"
        file.touch()
        assert end_of(client, job)["result"] == "waited"
        # Each job that asks makes it wait for another quiet moment.
        eventually(lambda: done(pause_s=1.5) == ["at once", "when no job is at work"])
        client.shutdown(grace_s=0.0)


def test_what_can_wait_is_prepared_while_the_server_serves(tmp_path):
    with Client.ensure(spec_in(tmp_path / "state", preload=f"{JOBS}:preload_in_steps")) as client:
        numbers = count()

        def done():
            job = client.submit(f"{JOBS}:steps_done", {}, label=f"steps-{next(numbers)}")
            return end_of(client, job)["result"] == [0, 1, 2]

        eventually(done)
        eventually(
            lambda: "its deferred preparation failed; workers do without" in client.files.log.read_text()
        )
        assert done()
        client.shutdown(grace_s=0.0)


def test_a_first_job_works_while_the_server_imports(tmp_path):
    file = tmp_path / "order"
    began = f"Path({os.fspath(file)!r}).exists()"
    slow = f"import time\nfrom pathlib import Path\nwhile not {began}: time.sleep(0.02)\n"
    spec = spec_in(tmp_path / "state", **write_module(tmp_path / "code", "slow_module", slow))
    ServerStart(spec, 60.0, (f"{JOBS}:watch_for_server", {"file": str(file)})).wait()
    with Client.ensure(spec) as client:
        eventually(lambda: file.exists() and file.read_text() == "began before it served, ended after")
        eventually(lambda: client.status()["jobs"] == [])
        client.shutdown(grace_s=0.0)


@pytest.mark.skipif(not Path("/proc/self/cmdline").exists(), reason="needs /proc")
def test_a_first_job_has_the_surroundings_of_its_server_which_no_command_line_shows(tmp_path, monkeypatch):
    monkeypatch.setenv("SURROUNDING", "a secret, " + "x" * 100_000)
    file = tmp_path / "surroundings"
    first_job = (f"{JOBS}:tell_surroundings", {"file": str(file)})
    ServerStart(spec_in(tmp_path / "state"), 60.0, first_job).wait()
    with Client.ensure(spec_in(tmp_path / "state")) as client:
        eventually(lambda: file.exists() and file.read_text() == os.environ["SURROUNDING"])
        commands = []
        for path in Path("/proc").glob("[0-9]*/cmdline"):
            with suppress(OSError):  # that process has just ended
                commands.append(path.read_bytes())
        assert any(b"tell_surroundings" in command for command in commands)
        assert not any(b"a secret" in command for command in commands)
        client.shutdown(grace_s=0.0)


def test_a_first_job_is_for_a_server_that_is_started(client, tmp_path):
    first_job = (f"{JOBS}:watch_for_server", {"file": str(tmp_path / "order")})
    ServerStart(spec_in(tmp_path / "state"), 60.0, first_job).wait()
    with Client.ensure(spec_in(tmp_path / "state")) as second:
        assert second.process == client.process
        assert not (tmp_path / "order").exists()


def test_a_server_serves_though_its_first_job_failed(tmp_path):
    ServerStart(spec_in(tmp_path / "state"), 60.0, (f"{JOBS}:fail", {})).wait()
    with Client.ensure(spec_in(tmp_path / "state")) as client:
        assert end_of(client, client.submit(f"{JOBS}:add", {"x": 1, "y": 2}, label="sum"))["result"] == 3
        client.shutdown(grace_s=0.0)


def test_a_server_with_a_first_job_looks_at_the_recipe_before_it_imports_the_rest(tmp_path):
    slow = write_module(tmp_path / "code", "slow_module", "import time\ntime.sleep(60)\n")
    recipe = tmp_path / "recipe.yaml"
    recipe.write_text("- no recipe")
    spec = spec_in(tmp_path / "state", recipe=recipe, **slow)
    with pytest.raises(BagAssetsError, match="the recipe starts with a list"):
        ServerStart(spec, 60.0, (f"{JOBS}:fail", {})).wait()
    eventually(lambda: not is_locked(ServerFiles(spec.state_folder, spec.stamp()).lock))


def test_a_server_that_cannot_start_shows_the_end_of_its_log(tmp_path):
    options = write_module(tmp_path / "code", "broken_module", "raise RuntimeError('broken beyond repair')\n")
    with pytest.raises(BagAssetsError, match="broken beyond repair"):
        Client.ensure(spec_in(tmp_path, **options))


def test_a_server_that_is_killed_while_it_starts_is_said_to_have_been_killed(tmp_path):
    spec = spec_in(tmp_path / "state", preload=f"{JOBS}:killed")
    with pytest.raises(BagAssetsError) as caught:
        ServerStart(spec).wait()
    said = str(caught.value)
    assert "it was killed by SIGKILL, maybe because the system ran out of memory" in said
    assert "exit code" not in said
    assert len(said.splitlines()) == 1, "it had nothing to say"


def test_a_module_that_starts_a_thread_is_refused(tmp_path):
    text = "import threading\nthreading.Thread(target=threading.Event().wait, name='a thread', daemon=True).start()\n"
    options = write_module(tmp_path / "code", "threading_module", text)
    with pytest.raises(BagAssetsError, match="a thread"):
        Client.ensure(spec_in(tmp_path, **options))


def test_a_module_that_is_not_there_is_named(tmp_path):
    with pytest.raises(BagAssetsError, match="no_such_module"):
        spec_in(tmp_path, modules=("no_such_module",))


def test_a_long_state_folder_still_gets_a_socket(tmp_path, monkeypatch):
    runtime = tmp_path / "run"
    runtime.mkdir()
    monkeypatch.setenv("XDG_RUNTIME_DIR", "/tmp" if len(str(runtime)) > 40 else str(runtime))
    folder = tmp_path / ("long" * 30)
    with Client.ensure(spec_in(folder)) as client:
        assert len(os.fsencode(client.files.socket)) <= 100
        assert client.files.socket.is_socket()
        assert client.files.socket.parent.stat().st_mode & 0o077 == 0
        monkeypatch.delenv("XDG_RUNTIME_DIR")  # as in a service, beside a session that has it
        assert [other.process for other in Client.all_of(folder)] == [client.process]
        client.shutdown()


# --- its own end -------------------------------------------------------------------------


@pytest.mark.parametrize(("minutes", "idle_s"), [(None, 900.0), ("", 900.0), ("0.5", 30.0), ("0", 1.0)])
def test_how_long_a_server_stays_up_is_said_by_a_variable(tmp_path, monkeypatch, minutes, idle_s):
    monkeypatch.delenv("BAGASSETS_SERVER_MINUTES", raising=False)
    if minutes is not None:
        monkeypatch.setenv("BAGASSETS_SERVER_MINUTES", minutes)
    assert server_spec(tmp_path, None).idle_timeout_s == idle_s
    assert server_spec(tmp_path, None, idle_timeout_s=7.0).idle_timeout_s == 7.0


def test_a_variable_that_is_no_number_is_refused(tmp_path, monkeypatch):
    monkeypatch.setenv("BAGASSETS_SERVER_MINUTES", "soon")
    with pytest.raises(BagAssetsError, match="BAGASSETS_SERVER_MINUTES=soon: how many minutes"):
        server_spec(tmp_path, None)


def test_a_server_is_not_idle_while_it_is_prepared(tmp_path):
    with Client.ensure(spec_in(tmp_path, idle_timeout_s=0.5, preload=f"{JOBS}:slow_preload")) as client:
        assert client.status()["jobs"] == []
        client.shutdown(grace_s=0.0)


def test_an_idle_server_ends_but_not_while_a_client_is_there(tmp_path):
    spec = spec_in(tmp_path, idle_timeout_s=0.2)
    client = Client.ensure(spec)
    stays = not eventually_within(2.0, lambda: not client.process.is_alive())
    assert stays
    path = client.files.socket
    client.close()
    eventually(lambda: not client.process.is_alive(), "the idle server is gone")
    assert not path.exists()
    assert Client.connect(client.files) is None


def eventually_within(seconds, condition):
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        if condition():
            return True
        time.sleep(0.05)
    return False


def test_a_server_whose_state_folder_was_removed_ends_and_spares_its_successor(tmp_path):
    spec = spec_in(tmp_path / "state")
    with Client.ensure(spec) as old:
        shutil.rmtree(tmp_path / "state")
        with Client.ensure(spec) as new:
            assert new.process != old.process
            old.close()
            eventually(lambda: not old.process.is_alive(), "the old one sees that its folder is gone")
            assert new.files.socket.is_socket()
            assert is_locked(new.files.lock)
            with Client.connect(new.files) as third:
                assert third.process == new.process
            new.shutdown(grace_s=0.0)


def test_a_killed_server_has_a_successor_and_its_workers_finish(tmp_path):
    go = tmp_path / "go"
    spec = spec_in(tmp_path / "state")
    old = Client.ensure(spec)
    old.submit(f"{JOBS}:wait", {"until": str(go)}, label="orphan", detached=True)
    worker = ProcessId.from_json(old.status()["jobs"][0]["process"])
    assert old.process.send(signal.SIGKILL)
    eventually(lambda: not old.process.is_alive())
    old.close()
    assert old.files.socket.exists(), "a killed server leaves its socket"
    with Client.ensure(spec) as new:
        assert new.process != old.process
        assert worker.is_alive()
        go.touch()
        eventually(lambda: not worker.is_alive(), "the orphan finishes")
        new.shutdown()


def test_a_client_of_a_dead_server_gets_an_error(client):
    client.process.send(signal.SIGKILL)
    with pytest.raises(ServerRefusedError):
        client.wait(WAIT_S)
    with Client.ensure(spec_in(client.files.state_folder)) as successor:
        successor.shutdown()
    with pytest.raises(ServerRefusedError):
        client.status()


def test_sigterm_ends_server_and_jobs(client):
    job = client.submit(f"{JOBS}:sleep", {}, label="s")
    await_start(client)
    client.process.send(signal.SIGTERM)
    assert end_of(client, job)["signal"] == "SIGTERM"
    eventually(lambda: not client.process.is_alive(), "the server is gone")


def test_leftovers_of_dead_servers_are_removed(tmp_path):
    folder = tmp_path / "forkserver"
    folder.mkdir()
    for name in ("feed.lock", "feed.log"):
        (folder / name).touch()
    with Client.ensure(spec_in(tmp_path)) as client:
        assert not list(folder.glob("feed.*"))
        client.shutdown()


def test_a_log_that_goes_as_old_ones_are_sought_does_no_harm(tmp_path):
    """As commands that another server of the project carries out remove theirs."""
    logs = tmp_path / "forkserver" / "logs"
    logs.mkdir(parents=True)
    (logs / "status.log").symlink_to("gone")
    with Client.ensure(spec_in(tmp_path)) as client:
        client.shutdown()


def leave_socket(path):
    """Leave a socket behind as a server does that is killed."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))


@pytest.mark.parametrize(
    "text",
    [None, b"", b"\0", b"\xff\xfe", b"relative/x.sock", b"/etc/hostname", b"SOCKET and more", b"SOCKET"],
)
def test_a_server_starts_whatever_another_left_of_socket_and_lock(tmp_path, text):
    spec = spec_in(tmp_path)
    files = ServerFiles(tmp_path, spec.stamp())
    files.make()
    leave_socket(files.choose_socket())
    if text is not None:
        files.lock.write_bytes(text.replace(b"SOCKET", bytes(files.choose_socket())))
    assert Client.connect(files) is None
    with Client.ensure(spec, timeout_s=60.0) as client:
        assert client.files.socket == files.choose_socket()
        client.shutdown()


def test_a_lock_that_names_a_file_of_others_has_nothing_removed(tmp_path):
    spec = spec_in(tmp_path / "copy")
    ours, theirs = (
        ServerFiles(tmp_path / "copy", spec.stamp()),
        ServerFiles(tmp_path / "original", spec.stamp()),
    )
    for files in (ours, theirs):
        files.make()
        leave_socket(files.choose_socket())
    precious = tmp_path / "precious.txt"
    precious.write_text("kept")
    ours.lock.write_text(str(theirs.choose_socket()))  # as in a copy of the state folder of a server at work
    ours.lock.with_name("feed.lock").write_text(str(precious))
    with Client.ensure(spec) as client:
        client.shutdown()
    assert theirs.choose_socket().is_socket()
    assert precious.read_text() == "kept"


@pytest.mark.parametrize("below", ["", "a" * 90], ids=["short", "too long for a socket"])
def test_a_server_that_cannot_note_its_socket_says_so_and_the_next_one_starts(tmp_path, below):
    folder = tmp_path / below
    folder.mkdir(exist_ok=True)
    spec = spec_in(folder)
    files = ServerFiles(folder, spec.stamp())
    files.make()
    command = [
        sys.executable,
        "-m",
        "bagassets.forkserver",
        json.dumps(spec._asdict(), default=os.fspath),
        spec.stamp(),
        "20",
    ]
    # A pipe takes more bytes, a file not one: as on a full disk.
    full = partial(resource.setrlimit, resource.RLIMIT_FSIZE, (0, 0))
    surroundings = os.environ | {"PYTHONPATH": str(TESTS)}
    ended = subprocess.run(
        command, check=False, capture_output=True, text=True, env=surroundings, preexec_fn=full
    )
    assert ended.returncode == 1
    assert re.search(
        r"\.sock: the fork server cannot create its socket, or note it in .*\.lock \(", ended.stderr
    )
    assert "Traceback" not in ended.stderr
    with Client.ensure(spec) as client:
        client.shutdown()


def test_a_socket_without_its_lock_is_removed_like_other_leftovers(tmp_path):
    leave_socket(tmp_path / "forkserver" / "feed.sock")
    with Client.ensure(spec_in(tmp_path)) as client:
        assert not list((tmp_path / "forkserver").glob("feed.*"))
        client.shutdown()


# --- what it is made of ------------------------------------------------------------------


def test_clients_import_neither_dagster_nor_numpy():
    code = (
        "import sys, bagassets.forkserver.tasks\n"
        "print([name for name in ('dagster', 'numpy', 'yaml', 'click') if name in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=TESTS.parent, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"


def test_a_process_is_known_by_more_than_its_number():
    sleeper = subprocess.Popen(["sleep", "600"])
    process = ProcessId.of(sleeper.pid)
    assert process.is_alive()
    assert ProcessId.from_json(process.as_json()) == process
    earlier = ProcessId(process.host, process.space, process.pid, process.started + "0")
    assert not earlier.is_alive()
    assert not earlier.send(signal.SIGKILL)
    rebooted = ProcessId(process.host, process.space + "x", process.pid, process.started)
    assert rebooted.is_on_this_host
    assert not rebooted.is_alive()
    elsewhere = ProcessId("another-machine", process.space, process.pid, process.started)
    assert not elsewhere.is_on_this_host
    assert not elsewhere.send(signal.SIGKILL)
    assert sleeper.poll() is None
    assert process.send(signal.SIGKILL)
    sleeper.wait()
    assert not process.is_alive()
    assert not process.send(signal.SIGTERM)


def test_a_zombie_does_not_count_as_alive():
    child = subprocess.Popen(["true"])
    process = ProcessId.of(child.pid)
    eventually(lambda: not process.is_alive(), "it has ended, though nobody waited for it")
    child.wait()


def test_places_of_a_stamp(tmp_path):
    files = ServerFiles(tmp_path, "0123456789abcdef0123")
    assert files.lock.name == "0123456789abcdef.lock"
    assert files.job_log("a/../b c").parent == tmp_path / "forkserver" / "logs"
