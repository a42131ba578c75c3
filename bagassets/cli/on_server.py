"""Commands that read Dagster's records, carried out by the server of their project if it is up.

To import Dagster takes two seconds, which the server has spent already; to read the records of some recordings takes a
tenth of one. What a worker writes goes through files, as it may be long.
"""

import io
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from bagassets.forkserver.client import Client, ServerRefusedError
from bagassets.forkserver.tasks import find_server
from bagassets.json_types import JsonObject

__all__ = ["answer", "run_on_server"]

_COMMANDS = frozenset({"status", "explain", "check"})
_OF_BUILD = frozenset({"--check", "--dry-run", "-n"})
_JOB = "bagassets.cli.on_server:answer"
_STREAMS = ("stdout", "stderr")
_PIECE_BYTES = 1 << 20


def run_on_server(arguments: Sequence[str]) -> int | None:
    """Have the server of a project carry out a command; return its exit status, or None if it is to be done here.

    Args:
        arguments: arguments of the command line, without the program.
    """
    recipe = _recipe_of(arguments)
    if recipe is None:
        return None
    client = find_server(Path(recipe).absolute())
    if client is None:
        return None
    label = f"{arguments[0]}-{os.urandom(16).hex()}"
    log = client.files.job_log(label)
    files = {name: log.with_suffix(f".{name}") for name in _STREAMS}
    status = None
    try:
        with client, suppress(ServerRefusedError, OSError):  # the command line does without it
            status = _wait_for(client, label, arguments, files)
        for name, file in files.items() if status is not None else ():
            _copy(file, name)
    finally:
        with suppress(OSError):
            for file in files.values():
                file.unlink(missing_ok=True)
            if log.stat().st_size == 0:
                log.unlink()
    return status


def answer(args: JsonObject) -> int:
    """Carry out a command in a worker of the server; return its exit status.

    Args:
        args: `arguments`, `columns` of the terminal ("" if there is none), `files` (stream -> file to write into), and
            `terminals` (names of those streams that end in one).
    """
    from bagassets.cli.main import main

    if args["columns"]:
        os.environ["COLUMNS"] = args["columns"]
    with _written_to(args["files"], args["terminals"]):
        try:
            return main(args["arguments"])
        except SystemExit as end:
            return end.code if isinstance(end.code, int) else int(end.code is not None)


def _recipe_of(arguments: Sequence[str]) -> str | None:
    """Return the recipe file that a command reads, if it is one that a server can carry out."""
    command, *options = arguments or [""]
    if command not in _COMMANDS and not (command == "build" and _OF_BUILD.intersection(options)):
        return None
    if {"--help", "-h"}.intersection(options):
        return None
    recipe = "recipe.yaml"
    rest = iter(options)
    for option in rest:
        if option == "--recipe":
            recipe = next(rest, "")
        elif option.startswith("--recipe="):
            recipe = option.removeprefix("--recipe=")
    return recipe or None


def _wait_for(client: Client, label: str, arguments: Sequence[str], files: dict[str, Path]) -> int | None:
    args = {
        "arguments": list(arguments),
        "columns": _columns(),
        "files": {name: str(file) for name, file in files.items()},
        "terminals": [name for name in _STREAMS if getattr(sys, name).isatty()],
    }
    job = client.submit(_JOB, args, label=label)
    while True:
        event = client.wait()
        if event is not None and event["job"] == job and event["event"] in {"finished", "killed"}:
            return int(event["result"]) if event.get("exit") == 0 else None


def _columns() -> str:
    """Return the width of the terminal, as libraries for terminals find it; "" if there is none."""
    with suppress(OSError, ValueError):
        return os.environ.get("COLUMNS") or str(os.get_terminal_size(sys.stdout.fileno()).columns)
    return ""


def _copy(file: Path, name: str) -> None:
    stream = getattr(sys, name)
    try:
        with file.open("rb") as written:
            while piece := written.read(_PIECE_BYTES):
                stream.buffer.write(piece)
        stream.flush()
    except BrokenPipeError:  # whoever reads it has read enough
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)


class _Stream(io.TextIOWrapper):
    """A file that says whether what it is copied to is a terminal."""

    is_terminal = False

    def isatty(self) -> bool:
        """Tell what the stream was told."""
        return self.is_terminal


@contextmanager
def _written_to(files: dict[str, str], terminals: Sequence[str]) -> Iterator[None]:
    """Have this process write its output into files."""
    with ExitStack() as stack:
        for name, file in files.items():
            written = stack.enter_context(Path(file).open("wb"))
            stream = stack.enter_context(_Stream(written, encoding="utf-8", errors="surrogateescape"))
            stream.is_terminal = name in terminals
            stack.callback(setattr, sys, name, getattr(sys, name))
            setattr(sys, name, stream)
        yield
