"""Commands that read Dagster's records, carried out by the server of their project if it is up.

Importing Dagster takes two seconds, which the server has spent already. Its worker writes to the standard output of the
command itself, so terminals, pipes and files get what they would get from the command, in the same order.
"""

import fcntl
import logging
import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from stat import S_ISREG

from bagassets.base.errors import BagAssetsError
from bagassets.base.json_types import JsonObject
from bagassets.base.unread_pipe import outliving_reader
from bagassets.forkserver.client import Client, ServerRefusedError
from bagassets.forkserver.process import ProcessId
from bagassets.forkserver.tasks import find_server

# Command -> its options without a value, and those with one.
COMMANDS: dict[str, tuple[frozenset[str], frozenset[str]]] = {
    "build": (
        frozenset({"--check", "--dry-run", "-n", "--json", "--retry-failed", "--allow-empty"}),
        frozenset({"--recipe", "--bag", "--select", "--jobs", "-j"}),
    ),
    "check": (frozenset({"--json"}), frozenset({"--recipe", "--bag"})),
    "explain": (frozenset({"--json"}), frozenset({"--recipe"})),
    "status": (frozenset({"--all", "--json"}), frozenset({"--recipe", "--bag"})),
}
_READING = frozenset({"--check", "--dry-run", "-n"})  # with one of these, a build only reads
_JOB = "bagassets.cli.on_server:answer"
_DESCRIPTORS = {"stdout": 1, "stderr": 2}
_FILES = tuple(_DESCRIPTORS.values())


def run_on_server(arguments: Sequence[str]) -> int | None:
    """Have the server of a project carry out a command; return its exit status, or None if it is to be done here.

    Args:
        arguments: arguments of the command line, without the program.
    """
    recipe = _recipe_of(arguments)
    if recipe is None or not all(map(_can_be_shared, _FILES)):
        return None
    with suppress(ServerRefusedError, OSError):  # the command line does without it
        client = find_server(Path(recipe).absolute())
        if client is not None:
            with client:
                status = _status_of(client, arguments)
            # Whoever writes next goes on after what the worker wrote.
            for descriptor in filter(_is_file, _FILES):
                os.lseek(descriptor, 0, os.SEEK_END)
            return status
    return None


def answer(args: JsonObject) -> int:
    """Carry out a command in a worker of the server; return its exit status.

    Args:
        args: `arguments`; `process`, whose output this is; `streams` (name -> encoding and how errors in it are handled);
            `log`, the file of the worker, which stays empty.

    Raises:
        BagAssetsError: that process cannot be written to from here.
    """
    from bagassets.cli.main import main

    _write_to(ProcessId.from_json(args["process"]), args["streams"])
    with suppress(OSError):
        Path(args["log"]).unlink()
    logging.getLogger().handlers.clear()  # those of the server
    try:
        return main(args["arguments"])
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else int(end.code is not None)


def _recipe_of(arguments: Sequence[str]) -> str | None:
    """Return the recipe that a command reads; None if it does more than that, or may be wrong."""
    command, *options = arguments or [""]
    if command not in COMMANDS:
        return None
    flags, with_value = COMMANDS[command]
    recipe, seen = "recipe.yaml", set()
    rest = iter(options)
    for option in rest:
        name, equals, value = option.partition("=")
        if name in with_value:
            value = value if equals else next(rest, "")
            recipe = value if name == "--recipe" else recipe
        elif option.startswith("-") and option not in flags:
            return None
        seen.add(name)
    return None if command == "build" and not _READING & seen else recipe or None


def _is_file(descriptor: int) -> bool:
    return S_ISREG(os.fstat(descriptor).st_mode)


def _can_be_shared(descriptor: int) -> bool:
    """Return whether another process, which can only append to a file, would write where this one does."""
    try:
        return (
            not _is_file(descriptor) or os.lseek(descriptor, 0, os.SEEK_CUR) == os.fstat(descriptor).st_size
        )
    except OSError:
        return False


def _status_of(client: Client, arguments: Sequence[str]) -> int | None:
    """Return the exit status of a command on the server, None if it failed to carry it out."""
    label = f"{arguments[0]}-{os.urandom(16).hex()}"
    args = {
        "arguments": list(arguments),
        "process": ProcessId.current().as_json(),
        "streams": {name: [getattr(sys, name).encoding, getattr(sys, name).errors] for name in _DESCRIPTORS},
        "log": str(client.files.job_log(label)),
    }
    client.submit(_JOB, args, label=label)
    while (event := client.wait()) is None or event["event"] == "note":
        pass
    return int(event["result"]) if event.get("exit") == 0 else None


def _write_to(process: ProcessId, streams: JsonObject) -> None:
    """Have this process write to the standard output and error of another one.

    Raises:
        BagAssetsError: it is of another machine or container, or has ended, or its output is of a kind that only it can use.
    """
    if not process.is_alive():
        raise BagAssetsError(f"{process}: it cannot be written to from here.")
    opened = {}
    for name, descriptor in _DESCRIPTORS.items():
        try:
            # Opening a pipe that nobody reads would wait; files are shared with whoever else writes to them.
            flags = os.O_WRONLY | os.O_APPEND | os.O_NONBLOCK | os.O_NOCTTY
            opened[name] = os.open(f"/proc/{process.pid}/fd/{descriptor}", flags)
        except OSError as err:
            raise BagAssetsError(f"{process}: its {name} cannot be opened ({err.strerror}).") from err
    for name, descriptor in _DESCRIPTORS.items():
        flags = fcntl.fcntl(opened[name], fcntl.F_GETFL)
        fcntl.fcntl(opened[name], fcntl.F_SETFL, flags & ~os.O_NONBLOCK)
        os.dup2(opened[name], descriptor)
        os.close(opened[name])
        encoding, errors = streams[name]
        stream = open(descriptor, "w", encoding=encoding, errors=errors, closefd=False)  # noqa: SIM115  (to the end of the process)
        setattr(sys, name, outliving_reader(stream))
