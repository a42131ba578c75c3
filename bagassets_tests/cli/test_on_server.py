"""Commands that read Dagster's records, carried out by the server of their project."""

import os
import pty
import re
import subprocess
import sys

import click
import pytest

from bagassets import __main__
from bagassets.base.unread_pipe import outliving_reader
from bagassets.cli import on_server
from bagassets.cli.main import root
from bagassets.forkserver.client import Client
from bagassets.forkserver.tasks import find_server
from bagassets.recipe import load_recipe
from bagassets_tests.in_process import make_project

pytestmark = [pytest.mark.xdist_group("on_server"), pytest.mark.once]
KEYS = ["a.bag", "b.mcap"]
COMMANDS = [
    ["status"],
    ["status", "--json", "--recipe=recipe.yaml"],
    ["status", "--bag", "nowhere"],
    ["explain", KEYS[0], "frames", "--recipe", "recipe.yaml"],
    ["explain", KEYS[0], "nothing"],
    ["check"],
    ["build", "-n"],
    ["build", "--check"],
    ["build", "--dry-run", "--json"],
]
# Says, too, which of some modules the command imported.
CODE = """
import os, sys
from bagassets.__main__ import main
try:
    sys.exit(main())
finally:
    found = {'click', 'dagster', 'rich'} & set(sys.modules)
    os.write(int(sys.stdin.readline()), ' '.join(sorted(found)).encode())
"""


@pytest.fixture(scope="module")
def recipe(tmp_path_factory):
    """A project with something to do: one of its recordings was touched."""
    recipe = make_project(tmp_path_factory.mktemp("on_server"), KEYS, duration_s=2.0)
    yield recipe
    stop(recipe)


@pytest.fixture
def served(recipe):
    """The project with its server up."""
    if not is_up(recipe):
        build = [sys.executable, "-m", "bagassets", "build", "--recipe", str(recipe)]
        subprocess.run(build, check=True, capture_output=True)
    (recipe.parent / "bags" / KEYS[1]).touch()
    return recipe


def stop(recipe):
    for client in Client.all_of(load_recipe(recipe).state):
        client.shutdown(grace_s=1.0)
    while is_up(recipe):
        pass


def is_up(recipe):
    client = find_server(recipe)
    if client is not None:
        client.close()
    return client is not None


def run(recipe, *arguments):
    """Exit status, stdout and stderr of a command, and what it imported."""
    reading, writing = os.pipe()
    command = [sys.executable, "-c", CODE, *arguments]
    done = subprocess.run(
        command,
        cwd=recipe.parent,
        input=f"{writing}\n",
        capture_output=True,
        text=True,
        check=False,
        pass_fds=[writing],
    )
    os.close(writing)
    with os.fdopen(reading) as stream:
        return (done.returncode, done.stdout, done.stderr), stream.read().split()


@pytest.mark.long
def test_a_server_that_is_up_carries_them_out_just_as_the_command_does(served):
    there = [run(served, *command) for command in COMMANDS]
    stop(served)
    here = [run(served, *command) for command in COMMANDS]
    assert [said for said, _ in there] == [said for said, _ in here]
    assert {status for (status, _, _), _ in here} == {0, 2, 3}
    assert [imported for _, imported in there] == [[]] * len(COMMANDS)
    assert all("dagster" in imported for _, imported in here)


def test_other_commands_are_left_alone(served):
    others = (
        [],
        ["build"],
        ["build", "--jobs", "1"],
        ["build", "--trace", "-n"],
        ["build", "--bag", "-n"],
        ["status", "--help"],
        ["status", "--recipe", "--bag"],
        ["explain", "-h"],
        ["gc", "-n"],
    )
    for arguments in others:
        assert on_server.run_on_server(arguments) is None


def test_all_its_commands_are_given_to_it():
    assert sorted(__main__._READING) == sorted(on_server.COMMANDS)


@pytest.mark.parametrize("command", sorted(on_server.COMMANDS))
def test_it_knows_which_options_have_a_value(command):
    is_flag = {
        name: option.is_flag
        for option in root.get_command(None, command).params
        if isinstance(option, click.Option)
        for name in option.opts
    }
    flags, with_value = on_server.COMMANDS[command]
    assert all(is_flag[name] for name in flags)
    assert not any(is_flag[name] for name in with_value)


def test_on_a_terminal_it_has_the_width_and_colours_of_the_terminal(served):
    read, write = pty.openpty()
    command = [sys.executable, "-m", "bagassets", "status"]
    environment = {**os.environ, "TERM": "xterm-256color", "COLUMNS": "90"}
    environment.pop("NO_COLOR", None)
    with subprocess.Popen(command, cwd=served.parent, stdout=write, stderr=write, env=environment) as process:
        os.close(write)
        said = b""
        try:
            while piece := os.read(read, 1 << 16):
                said += piece
        except OSError:  # how a terminal ends
            pass
    os.close(read)
    assert process.returncode == 3
    assert b"\x1b[32mfresh" in said
    plain = re.sub(r"\x1b\[[0-9;]*m", "", said.decode()).splitlines()
    assert max(len(line) for line in plain if "─" in line) <= 90


SHELLS = [
    "{} status --json | head -1",
    "echo before > out; {} build -n -j 99 >> out 2>&1; cat out",
    "{} status >&-",
    "{} status --bag nope 2> /dev/full",
    "env -u COLUMNS script -qec '{} status' /dev/null < /dev/null",
]
MORE_SHELLS = [
    "set -o pipefail; {} status --json | true",
    "{{ {} status; echo after; }} > out; cat out",
    "{} build -n -j 99 1<> out",
    "{} build -n -j 99 2>&1 | cat",
    "{} build --check 2>&-",
    "{} check >&-",
    "{} build -n <&- >&- 2>&-",
    "mkdir gone; cd gone; rmdir ../gone; {} status",
    "PYTHONIOENCODING=latin-1 {} status --bag 'mön*' 2>&1 | cat",
]


@pytest.mark.parametrize(
    "shell", [*SHELLS, *(pytest.param(shell, marks=pytest.mark.long) for shell in MORE_SHELLS)]
)
def test_whatever_it_writes_to_gets_the_same(served, shell):
    """The variable gives the command another stamp, so that it finds no server."""

    def said(command):
        done = subprocess.run(
            ["bash", "-c", shell.format(command)], cwd=served.parent, capture_output=True, check=False
        )
        (served.parent / "out").unlink(missing_ok=True)
        return done.returncode, done.stdout, re.sub(rb"/tmp/bagassets-\S+", b"", done.stderr)

    assert said(f"{sys.executable} -m bagassets") == said(
        f"env PYTHONHASHSEED=0 {sys.executable} -m bagassets"
    )


@pytest.mark.parametrize(("command", "status"), [("status --json", 3), ("docs recipe", 0)])
def test_a_reader_that_goes_away_does_not_change_the_status(served, command, status):
    """Nobody has to be quick enough: what is written is more than a pipe holds, or its reader is gone at once."""
    piped = f"set -o pipefail; {sys.executable} -m bagassets {command} | true"
    done = subprocess.run(["bash", "-c", piped], cwd=served.parent, capture_output=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (status, b"", b"")


def test_what_is_written_to_nobody_is_dropped():
    read, write = os.pipe()
    with os.fdopen(write, "w") as plain:
        stream = outliving_reader(plain)
        print("read", file=stream, flush=True)
        assert os.read(read, 99) == b"read\n"
        os.close(read)
        for _ in range(2):
            print("x" * 100_000, file=stream, flush=True)


def test_a_full_disk_costs_the_command_and_not_the_server(served):
    with find_server(served) as client:
        server = client.process
    done = subprocess.run(
        ["bash", "-c", f"{sys.executable} -m bagassets status > /dev/full"],
        cwd=served.parent,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode != 0
    assert "No space left on device" in done.stderr
    assert "Traceback" not in done.stderr
    with find_server(served) as client:
        assert client.process == server
        assert client.status()["jobs"] == []


def test_what_goes_wrong_there_is_tried_here(served, monkeypatch):
    monkeypatch.setattr(on_server, "_JOB", "bagassets.cli.on_server:no_such_function")
    assert on_server.run_on_server(["status", "--recipe", str(served)]) is None


def test_no_files_are_left(served, capfdbinary):
    with find_server(served) as client:
        folder = client.files.folder / "logs"
    before = set(folder.iterdir())
    assert on_server.run_on_server(["status", "--recipe", str(served)]) == 3
    assert b"a.bag" in capfdbinary.readouterr().out
    assert set(folder.iterdir()) == before
