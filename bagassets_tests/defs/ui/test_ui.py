"""`bagassets ui`: really started, looked at through its GraphQL, and ended as users end it."""

import asyncio
import json
import re
import signal
import socket
import subprocess
import sys
from contextlib import suppress
from http.client import HTTPConnection
from importlib.metadata import version
from pathlib import Path
from urllib.parse import quote
from urllib.request import Request, urlopen

import pytest
from click.testing import CliRunner
from starlette.responses import PlainTextResponse
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from bagassets.base.errors import BagAssetsError
from bagassets.cli.main import main
from bagassets.cli.ui import ui
from bagassets.defs.ui.guard import Guard, own_names
from bagassets.defs.ui.services import end_group, end_servers
from bagassets.forkserver.client import Client, ServerRefusedError
from bagassets.forkserver.spec import ServerSpec
from bagassets.recipe import load_recipe
from bagassets_tests.services import (
    BIN,
    WAIT_S,
    bare_environment,
    eventually,
    free_port,
    make_project,
    processes_of,
    running,
)
from bagassets_tests.small_drive import write_drive

pytestmark = pytest.mark.xdist_group("ui")


@pytest.fixture
def project(tmp_path):
    write_drive(tmp_path / "bags" / "a.bag", "ros1", duration_s=2.0)
    return make_project(tmp_path)


def ask(url, query):
    request = Request(
        f"{url}/graphql", json.dumps({"query": query}).encode(), {"Content-Type": "application/json"}
    )
    with urlopen(request, timeout=30) as answer:
        return json.load(answer)["data"]


def servers_of(project):
    return [client.process.pid for client in Client.all_of(project / ".bagassets")]


@pytest.mark.parametrize("missing", ["dagster_webserver", "uvicorn"])
def test_without_the_web_server_it_says_what_to_install(missing, tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, missing, None)
    assert main(["ui", "--recipe", str(make_project(tmp_path) / "recipe.yaml")]) == 1
    [line] = capsys.readouterr().err.splitlines()
    assert line == (
        "error: the web UI needs dagster-webserver, which is not installed here, or not with all that it requires: "
        f"`pip install dagster-webserver=={version('dagster')}`. Builds, the sensor and all other commands do without."
    )


def test_it_shows_the_project_and_leaves_nothing_behind(project):
    log = project.parent / "ui.log"
    port = free_port()
    # From another folder, with the recipe named: nothing depends on where it is started.
    command = [BIN / "bagassets", "ui", "--recipe", project / "recipe.yaml", "--port", port, "--no-browser"]
    # Any process may come to have a handler on its root logger: now and then Dagster's storage logs to that one.
    early = project.parent / "early"
    early.mkdir()
    (early / "sitecustomize.py").write_text("import logging; logging.basicConfig()\n")
    with running(command, project.parent, log, {"PYTHONPATH": str(early)}) as process:
        url = f"http://127.0.0.1:{port}"
        eventually(lambda: url in log.read_text(), "it tells its address")
        nodes = ask(url, "{ assetNodes { assetKey { path } description groupName kinds } }")["assetNodes"]
        assert {"bag", "frames", "nuscenes_dataset"} <= {node["assetKey"]["path"][0] for node in nodes}
        assert all(node["description"] and node["groupName"] and node["kinds"] for node in nodes)
        eventually(lambda: servers_of(project), "a server is ready for runs")
        eventually((project / "dataset/nuscenes/v1.0-test/scene.json").is_file, "the sensor has it built")

        see_pictures(port, project)
        again = [*command, "--port", free_port()]
        second = subprocess.run(
            [str(p) for p in again],
            check=False,
            capture_output=True,
            text=True,
            env=bare_environment(),
            timeout=180,
        )
        assert second.returncode == 1
        assert f"is running already at {url}" in second.stderr

        # Tables are there before their run ends, and Ctrl-C would say that it waits for one.
        active = "{ runsOrError(filter: {statuses: [QUEUED, STARTING, STARTED]}) { ... on Runs { results { id } } } }"
        eventually(lambda: not ask(url, active)["runsOrError"]["results"], "the runs have ended")
        sessions = [process.pid, *child_sessions(process.pid)]
        # Else the log has a line of gRPC, if it notices that a code server ends before the web server has.
        assert b"GRPC_VERBOSITY=ERROR" in Path("/proc", str(sessions[1]), "environ").read_bytes().split(b"\0")
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 0
        assert [pid for session in sessions for pid in processes_of(session)] == []
        eventually(lambda: servers_of(project) == [], "the fork server has ended")
    left = {path.name for path in project.iterdir()}
    assert left == {
        "recipe.yaml",
        "dagster.yaml",
        "workspace.yaml",
        ".env",
        "definitions.py",
        "pyproject.toml",
    } | {
        ".bagassets",
        "dataset",
    }
    assert log.read_text().splitlines() == [f"{url}  (web UI of project; Ctrl-C ends it)"]


def see_pictures(port, project):
    """Follow the links of a picture; see that nothing but pictures is served."""
    (answer,) = ask(
        f"http://127.0.0.1:{port}",
        """{ assetNodes(pipeline: {pipelineName: "__ASSET_JOB", repositoryName: "__repository__",
             repositoryLocationName: "bagassets.definitions"}, assetKeys: [{path: "preview"}]) {
          assetMaterializations(limit: 1) { metadataEntries { label ... on MarkdownMetadataEntry { mdStr } } }
        } }""",
    )["assetNodes"]
    entries = answer["assetMaterializations"][0]["metadataEntries"]
    timeline = next(entry["mdStr"] for entry in entries if entry["label"] == "picture_timeline")
    shown, link = re.fullmatch(r"\[!\[\]\((/[^)]+)\)\]\((/\S+) .+\)", timeline).groups()
    host = {"Host": f"127.0.0.1:{port}"}
    with urlopen(f"http://127.0.0.1:{port}{shown}", timeout=30) as picture:
        # Not in the whole project, where what a run makes comes and goes.
        artifacts = load_recipe(project / "recipe.yaml").store_path / "artifacts"
        (file,) = artifacts.glob(f"*/{link.split('/')[-2]}/files/inline/timeline.jpg")
        assert picture.read() == file.read_bytes()
    with urlopen(f"http://127.0.0.1:{port}{link}", timeout=30) as picture:
        digest, name = link.split("/")[-2:]
        (file,) = artifacts.glob(f"*/{digest}/files/{name}")
        assert (picture.read(), picture.headers["Content-Type"]) == (file.read_bytes(), "image/jpeg")
        assert picture.headers["X-Content-Type-Options"] == "nosniff"
    for other in (
        link.replace("timeline.jpg", "facts.json"),
        link.replace(digest, "0" * 64),
        f"{link}/../x.jpg",
    ):
        status, text = request(port, "GET", other, **host)
        assert (status, "Traceback" in text) == (404, False)
    assert request(port, "POST", link, **host)[0] == 405


def request(port, method, path, body=None, **headers):
    """Return status and text of the answer to a request with just these headers."""
    connection = HTTPConnection("127.0.0.1", port, timeout=30)
    try:
        connection.putrequest(method, path, skip_host=True, skip_accept_encoding=True)
        for name, value in headers.items():
            connection.putheader(name.replace("_", "-"), value)
        connection.putheader("Content-Length", str(len(body or "")))
        connection.endheaders((body or "").encode())
        answer = connection.getresponse()
        return answer.status, answer.read().decode("utf-8", "replace")
    finally:
        connection.close()


WIPE = 'mutation { deletePipelineRun(runId: "none") { __typename } }'
READ = "{ version }"


@pytest.mark.once
def test_it_refuses_what_other_sites_ask_of_it(project):
    log, port = project.parent / "ui.log", free_port()
    names = ["--allow-host", "proxy.example"]
    command = [
        BIN / "bagassets", "ui", "--recipe", project / "recipe.yaml", "--port", port, "--no-browser", *names,
    ]  # fmt: skip
    with running(command, project, log):
        eventually(lambda: f":{port}" in log.read_text(), "it tells its address")
        own = f"127.0.0.1:{port}"

        def get(path, **headers):
            return request(port, "GET", path, **{"Host": own} | headers)

        def post(query, **headers):
            body = json.dumps({"query": query})
            return request(
                port, "POST", "/graphql", body, Content_Type="application/json", **{"Host": own} | headers
            )

        # What the page itself does.
        for host in (own, f"localhost:{port}", "localhost", f"[::1]:{port}", "LOCALHOST", "proxy.example"):
            status, page = get("/", Host=host)
            assert (status, "<!DOCTYPE html>" in page or "<!doctype html>" in page) == (200, True), host
        assert get("/assets", Origin="https://evil.example")[0] == 200  # a link from elsewhere
        assert get(f"/graphql?query={quote(READ)}")[0] == 200
        assert post(READ)[0] == 200
        assert post(WIPE)[1].count("RunNotFoundError") == 1
        assert post(READ, Origin=f"http://{own}")[0] == 200
        assert post(READ, Host="proxy.example", Origin="https://proxy.example")[0] == 200
        assert post(READ, Host="proxy.example:443", Origin="https://proxy.example")[0] == 200

        # Changing something takes a POST.
        for query in (WIPE, f"query a {READ} {WIPE}", f"subscription s {{ x }} {READ}"):
            for path in ("/graphql", "/graphql/"):
                status, answer = get(f"{path}?query={quote(query)}", Accept="image/*")
                assert status == 405, query
                assert "sent with POST" in answer
        assert get(f"/graphql?query={quote(READ)}&query={quote(WIPE)}")[0] == 405
        assert get(f"/graphql?query={quote('{ not')}")[0] == 400

        # A foreign name that was made to mean this machine.
        for host in (
            "evil.example",
            f"evil.example:{port}",
            "127.0.0.1.evil.example",
            "192.0.2.7",
            "",
            "a b",
            "[::2]",
        ):
            status, answer = get("/", Host=host)
            assert status in {400, 421}, host
            assert "<script" not in answer
            assert post(READ, Host=host)[0] in {400, 421}
        assert request(port, "GET", "/")[0] in {400, 421}

        # The page of another site.
        for origin in (
            "https://evil.example", "null", f"http://127.0.0.1:{port + 1}", f"http://{own}.evil.example",
            f"http://evil@{own}", f"http://localhost:{port}", f"file://{own}", "",
        ):  # fmt: skip
            assert post(READ, Origin=origin)[0] == 403, origin
            form = request(
                port,
                "POST",
                f"/graphql?query={quote(WIPE)}",
                Host=own,
                Origin=origin,
                Content_Type="text/plain",
            )
            assert form[0] == 403
            assert (
                request(port, "POST", "/report_asset_materialization/bag", "{}", Host=own, Origin=origin)[0]
                == 403
            )

        # Subscriptions.
        address = f"ws://{own}/graphql"
        assert subscribed(address, f"http://{own}")["type"] == "data"
        assert subscribed(address, None)["type"] == "data"
        with pytest.raises(InvalidStatus, match="403"):
            subscribed(address, "https://evil.example")


def subscribed(address, origin):
    """Return the first message of a subscription, as the web UI makes them."""
    query = 'subscription { pipelineRunLogs(runId: "none") { __typename } }'
    with connect(address, subprotocols=["graphql-ws"], origin=origin) as socket:
        socket.send(json.dumps({"type": "connection_init"}))
        assert json.loads(socket.recv(10))["type"] == "connection_ack"
        socket.send(json.dumps({"type": "start", "id": "1", "payload": {"query": query}}))
        return json.loads(socket.recv(10))


@pytest.mark.parametrize(
    ("host", "own", "foreign"),
    [
        ("127.0.0.1", ["localhost", "127.0.0.1:3000", "[::1]"], ["10.0.0.5", "robot", "[fe80::1]"]),
        ("robot.lan", ["robot.lan:3000", "Robot.LAN", "localhost"], ["10.0.0.5", "lan", "robot.lan.evil"]),
        (
            "0.0.0.0",
            ["10.0.0.5:3000", "[fe80::1]:3000", socket.gethostname()],
            ["evil.example", "1.2.3", "::1"],
        ),
        ("::", ["10.0.0.5:3000", "[fe80::1]"], ["evil.example", "0x7f000001.example"]),
    ],
)
def test_the_names_that_it_goes_by(host, own, foreign):
    async def served(scope, receive, send):
        await PlainTextResponse("served")(scope, receive, send)

    def status(name):
        answers = []

        async def send(message):
            answers.append(message)

        headers = [(b"host", name.encode())]
        scope = {"type": "http", "method": "GET", "path": "/", "query_string": b"", "headers": headers}
        asyncio.run(Guard(served, own_names(host))(scope, None, send))
        return answers[0]["status"]

    assert {name: status(name) for name in own} == dict.fromkeys(own, 200)
    assert {name: status(name) for name in foreign} == dict.fromkeys(foreign, 421)


def child_sessions(pid):
    """Return the processes that lead sessions of their own and were started by `pid`."""
    children = subprocess.run(
        ["ps", "-o", "sid=", "--ppid", str(pid)], check=False, capture_output=True, text=True
    )
    return [int(sid) for sid in children.stdout.split()]


@pytest.mark.once
def test_it_ends_when_whoever_started_it_is_killed(project):
    log = project.parent / "ui.log"
    command = [
        BIN / "bagassets",
        "ui",
        "--recipe",
        project / "recipe.yaml",
        "--port",
        free_port(),
        "--no-browser",
    ]
    with running(command, project, log) as process:
        eventually(lambda: child_sessions(process.pid), "Dagster is started")
        sessions = child_sessions(process.pid)
        process.kill()
        process.wait()
        eventually(lambda: not any(processes_of(pid) for pid in sessions), "all processes are gone")


@pytest.mark.long
def test_it_ends_even_if_its_interrupt_is_lost(project):
    # As Python loses it in a finalizer, or while a module is imported.
    code = (
        "import signal; from bagassets.defs.ui import dev; "
        "signal.signal(signal.SIGINT, lambda *_: None); dev.main()"
    )
    command = [
        BIN / "python",
        "-c",
        code,
        "--host",
        "127.0.0.1",
        "--port",
        free_port(),
        "--log-level",
        "warning",
    ]
    environment = {"DAGSTER_HOME": str(project), "BAGASSETS_RECIPE": str(project / "recipe.yaml")}
    with running(command, project, project.parent / "dev.log", environment) as process:
        assert process.wait(WAIT_S) == 0


@pytest.fixture
def server(tmp_path):
    spec = ServerSpec(
        tmp_path / "state", modules=("forkserver_jobs",), paths=(str(Path(__file__).parents[2]),)
    )
    with Client.ensure(spec.located()) as client:
        yield client
        with suppress(ServerRefusedError):
            client.shutdown(grace_s=0.0)


def end(server, cancel):
    """End a server as the web UI does; return the number of jobs that were waited for."""
    reported = []
    files = server.files
    server.close()
    end_servers([files], reported.append, cancel=cancel)
    eventually(lambda: Client.connect(files) is None, "the server has ended")
    return reported


def test_runs_at_work_are_waited_for(server, tmp_path):
    until = tmp_path / "until"
    server.submit("forkserver_jobs:wait", {"until": str(until)}, label="run", detached=True)
    asked = []

    def cancel():
        asked.append(True)
        if len(asked) == 3:
            until.touch()
        return False

    assert end(server, cancel) == [1]
    assert len(asked) >= 3


def test_runs_at_work_are_cancelled_on_demand(server):
    server.submit("forkserver_jobs:sleep", {}, label="run", detached=True)
    assert end(server, lambda: True) == [1]


def test_an_idle_server_ends_without_a_word(server):
    assert end(server, lambda: False) == []


@pytest.mark.once
def test_a_server_that_a_build_uses_stays(server):
    end_servers([server.files], pytest.fail, cancel=lambda: False)
    assert server.status()["draining"] is False


def test_what_is_ending_by_itself_is_not_interrupted():
    """As a code server was now and then, which wrote a traceback to the terminal from where it waited for its threads."""
    code = (
        "import signal, time; signal.signal(signal.SIGTERM, lambda *_: print('interrupted', flush=True)); "
        "print('ending', flush=True); time.sleep(300)"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        assert process.stdout.readline() == "ending\n"
        end_group(process.pid)
        assert (process.wait(WAIT_S), process.stdout.read()) == (-signal.SIGKILL, "")


@pytest.mark.parametrize("ignored", [False, True])
def test_signals_are_its_own_until_it_ends_but_for_what_nohup_ignores(project, monkeypatch, ignored):
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = {number: signal.getsignal(number) for number in numbers}
    meanwhile = {}

    def services(*_args, **_options):
        meanwhile.update({number: signal.getsignal(number) for number in numbers})
        raise BagAssetsError("no")

    monkeypatch.setattr("bagassets.defs.ui.services.Services", services)
    try:
        found = {**before, signal.SIGHUP: signal.SIG_IGN if ignored else signal.SIG_DFL}
        signal.signal(signal.SIGHUP, found[signal.SIGHUP])
        assert main(["ui", "--recipe", str(project / "recipe.yaml")]) == 1
        assert {number: signal.getsignal(number) for number in numbers} == found
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    assert [number for number in numbers if meanwhile[number] == found[number]] == [signal.SIGHUP] * ignored


def test_an_unknown_host_is_reported_in_a_sentence(project, capsys):
    status = main(["ui", "--recipe", str(project / "recipe.yaml"), "--host", "no.such.host.invalid"])
    assert status == 1
    assert "no.such.host.invalid: no such address on this machine" in capsys.readouterr().err


def test_a_taken_port_is_reported_with_one_that_is_free(project, capsys):
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        status = main(["ui", "--recipe", str(project / "recipe.yaml"), "--port", str(port)])
    assert status == 1
    err = capsys.readouterr().err
    free = int(err.partition("--port ")[2].rstrip(".\n"))
    assert free > port
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", free))


def test_a_missing_recipe_is_reported_before_anything_is_started(tmp_path, capsys):
    assert main(["ui", "--recipe", str(tmp_path / "recipe.yaml")]) == 1
    assert "no recipe here" in capsys.readouterr().err


def test_the_help_has_examples():
    shown = CliRunner().invoke(ui, ["--help"]).output
    assert "bagassets ui --recipe" in shown
    for option in ("--recipe", "--port", "--host", "--no-browser"):
        assert option in shown
