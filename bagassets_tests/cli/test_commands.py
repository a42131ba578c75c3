"""Every command as users meet it: in the overview, in its own help, and in the pages that it cites."""

import ast
import errno
import os
import re
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import click
import pytest
from pydantic_core import SchemaError

import bagassets
from bagassets.__main__ import main as program
from bagassets.base import files
from bagassets.cli import docs as docs_command
from bagassets.cli.docs import all_commands
from bagassets.cli.exit_status import ExitStatus
from bagassets.cli.main import COMMANDS, main, root
from bagassets.store import collect as store_collect
from bagassets_tests.services import WAIT_S
from bagassets_tests.small_drive import RECIPE

# A page by its file; references are written to one with `bagassets docs … > docs/….md`.
PAGE_FILE = re.compile(r"(?<!> )(?<![\w/])docs/[a-z-]+\.md")
LEAVES = {name: command for name, command in all_commands() if not isinstance(command, click.Group)}


@pytest.mark.parametrize("name", COMMANDS)
def test_the_overview_says_what_the_command_says(name):
    command = root.get_command(click.Context(root), name)
    assert command is not None
    assert " ".join(command.help.partition("\n\n")[0].split()) == COMMANDS[name]


@pytest.mark.parametrize("name", LEAVES)
def test_every_command_has_examples_that_call_it(name):
    assert "Examples:" in LEAVES[name].epilog
    assert f"\n  {name}" in LEAVES[name].epilog


@pytest.mark.parametrize("name", LEAVES)
def test_every_option_is_explained(name):
    for parameter in LEAVES[name].params:
        if isinstance(parameter, click.Option):
            assert parameter.help, parameter.name
            assert parameter.help.rstrip().endswith("."), parameter.name


@pytest.mark.parametrize("name", LEAVES)
def test_no_number_may_be_infinite_or_none_at_all(name):
    for parameter in LEAVES[name].params:
        if isinstance(parameter.type, click.FloatRange):
            for text in ("nan", "inf", "-inf"):
                with pytest.raises(click.BadParameter):
                    parameter.type.convert(text, parameter, None)
            assert parameter.type.convert("2", parameter, None) == 2
        assert parameter.type is not click.FLOAT


def test_a_mistyped_command_is_answered_with_the_one_that_was_meant(capsys):
    assert main(["biuld"]) == 2
    assert "Did you mean build?" in capsys.readouterr().err


@pytest.mark.parametrize("place", ["file/drive.mcap", "file/deeper/drive.bag", "file/drive"])
def test_a_place_that_cannot_be_is_reported_and_is_no_defect(tmp_path, capsys, place):
    (tmp_path / "file").write_text("not a folder")
    assert main(["sample", str(tmp_path / place)]) == ExitStatus.FAILED
    output = capsys.readouterr().err
    assert f"{tmp_path / 'file'}" in output
    assert "fix this one" in output


@pytest.mark.parametrize("arguments", [["status"], ["build"], ["demo"]])
def test_a_current_folder_that_is_gone_is_no_defect(tmp_path, capsys, monkeypatch, arguments):
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    assert main(arguments) == ExitStatus.FAILED
    assert "error: the current folder is gone; change to one that is there" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("error", "said"),
    [
        ("EIO", "{} cannot be read or written (Input/output error); check the disks"),
        ("ENOSPC", "{}: No space left on device; name another path, or fix this one"),
    ],
)
def test_a_disk_that_fails_is_reported_and_is_no_defect(tmp_path, capsys, monkeypatch, error, said):
    (tmp_path / "bags").mkdir()
    (tmp_path / "recipe.yaml").write_text(RECIPE.format(name="x", root="bags"))

    def collect(_store, _garbage, _now_s):
        monkeypatch.setattr(files, "os", SimpleNamespace(**vars(os) | {"write": fail}))
        files.write(tmp_path / "file", b"x")

    def fail(_descriptor, _data):
        number = getattr(errno, error)
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(store_collect, "collect", collect)
    assert main(["gc", "--recipe", str(tmp_path / "recipe.yaml")]) == ExitStatus.FAILED
    assert f"error: {said.format(tmp_path / 'file')}" in capsys.readouterr().err


def test_pages_are_listed_and_printed(capsys):
    assert main(["docs", "page"]) == 0
    *lines, where = capsys.readouterr().out.splitlines()
    docs = Path(bagassets.__file__).parents[1] / "docs"
    assert [line.split()[0] for line in lines] == sorted(path.stem for path in docs.glob("*.md"))
    assert where == f"They are in {docs}"
    assert main(["docs", "page", "formats"]) == 0
    assert capsys.readouterr().out == (docs / "formats.md").read_text("utf-8")


def test_a_page_that_is_not_there_is_answered_with_those_that_are(capsys):
    assert main(["docs", "page", "format"]) == 2
    assert "no page 'format'; the pages are annotations, " in capsys.readouterr().err


def test_where_no_pages_are_installed_that_is_said(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(docs_command, "_CHECKOUT", tmp_path)
    monkeypatch.setattr(docs_command, "files", lambda _name: None)
    assert main(["docs", "page", "formats"]) == ExitStatus.FAILED
    assert "there are no pages" in capsys.readouterr().err


def test_every_page_that_the_code_cites_exists():
    """Whoever installed a wheel has no `docs/`, so what users read names the command."""
    sources = {path: path.read_text("utf-8") for path in Path(bagassets.__file__).parent.rglob("*.py")}
    cited = {
        (path, name) for path, text in sources.items() for name in re.findall(r"docs\s+page ([a-z-]+)", text)
    }
    assert len(cited) > 5
    assert {name for _, name in cited} <= set(docs_command.find_pages())
    assert not [(path, text) for path in sources for text in _messages(path) if PAGE_FILE.search(text)]


@pytest.mark.parametrize("at", ["bagassets.engine.freshness.decide.nothing_to_do", "bagassets.cli.main.main"])
def test_an_interrupt_before_the_command_line_is_there_is_no_traceback(monkeypatch, capsys, at):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(at, interrupted)
    monkeypatch.setattr(sys, "argv", ["bagassets", "build", "--recipe", "/no/such/recipe.yaml"])
    assert program() == ExitStatus.INTERRUPTED
    assert capsys.readouterr().err == "Interrupted.\n"


class Named:
    def __set_name__(self, _owner, _name):
        raise KeyboardInterrupt


def made():
    class _Made:
        name = Named()


def validated():
    raise SchemaError('Error building "model" validator:\n  KeyboardInterrupt: ')


@pytest.mark.parametrize("interrupted", [made, validated])
def test_an_interrupt_in_the_middle_of_a_class_is_no_defect(monkeypatch, capsys, interrupted):
    """Python 3.11 and pydantic give another error then; of an interrupt, click says an empty line first."""
    monkeypatch.setattr("bagassets.cli.plugins.echo", lambda *_: interrupted())
    assert main(["decoders"]) == ExitStatus.INTERRUPTED
    assert capsys.readouterr().err.lstrip("\n") == "Interrupted.\n"


@pytest.mark.parametrize(
    ("moment", "ended"),
    [
        ("Interrupting(); time.sleep(600)", (130, "", "Interrupted.\n")),  # it is not lost
        ("threading.Thread(target=interrupt_at_exit).start(); return 0", (-signal.SIGINT, "", "")),
    ],
    ids=["in a finalizer", "at the end"],
)
def test_an_interrupt_where_python_would_print_it_and_go_on_is_no_traceback(moment, ended):
    """As in one of a hundred in the two seconds that Dagster's import takes, or by a second Ctrl-C."""
    code = f"""
import os, signal, threading, time
from bagassets import __main__

class Interrupting:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)

def interrupt_at_exit():
    while threading.main_thread().is_alive():
        time.sleep(0.01)
    Interrupting()
    time.sleep(600)

def main():
    {moment}

signal.signal(signal.SIGINT, signal.default_int_handler)
__main__._main = main
__main__.run()
"""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=WAIT_S
    )
    assert (done.returncode, done.stdout, done.stderr) == ended


def _messages(path):
    """Yield the texts in a module that are no docstrings."""
    tree = ast.parse(path.read_text("utf-8"))
    docstrings = {
        id(node.value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docstrings:
            yield node.value


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a device that is always full is a thing of Linux")
def test_output_that_cannot_be_written_is_one_sentence():
    command = [sys.executable, "-m", "bagassets", "formats"]
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == ExitStatus.FAILED
    (line,) = done.stderr.splitlines()
    assert line.startswith("error: the output of this command, or a file, cannot be written")


def test_whoever_reads_the_output_may_stop_reading():
    ours, theirs = os.pipe()
    os.close(ours)
    try:
        done = subprocess.run(
            [sys.executable, "-u", "-m", "bagassets", "formats"],
            stdout=theirs, stderr=subprocess.PIPE, text=True, check=False,
        )  # fmt: skip
    finally:
        os.close(theirs)
    assert (done.returncode, done.stderr) == (0, "")
