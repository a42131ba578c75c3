"""Printing for commands: names come from recordings, so everything that a terminal would obey is escaped."""

import errno
import os
import sys
from typing import TYPE_CHECKING

import click

from bagassets.base.disk_errors import FULL
from bagassets.base.escaping import terminal, visible
from bagassets.cli.exit_status import ExitStatus

if TYPE_CHECKING:
    from pathlib import Path

    from rich.console import Console


def echo(line: str, *, err: bool = False) -> None:
    """Print one line; line breaks, which can only be part of a name, are spelled out."""
    click.echo(visible(line), err=err)


def echo_lines(text: str, *, err: bool = False, nl: bool = True) -> None:
    """Print several lines in which no name has a line break: JSON, tables, error messages."""
    click.echo(terminal(text), err=err, nl=nl)


def echo_json(value: object) -> None:
    """Print a value as JSON of several lines."""
    import json

    echo_lines(json.dumps(value, indent=1))


def print_lines(console: "Console", text: str) -> None:
    """Print lines as `echo_lines` does, on a console of rich."""
    console.print(terminal(text), markup=False, soft_wrap=True)


def quoted(path: "Path") -> str:
    """Return a path as it can be typed in the current folder."""
    import shlex

    path, here = path.absolute(), path.cwd()
    return shlex.quote(str(path.relative_to(here) if path.is_relative_to(here) else path))


def status_of_unwritten(err: OSError) -> int | None:
    """Say why the output of a command cannot be written; return its exit status, or None if `err` is about something else."""
    if err.errno in FULL and err.filename is None:
        echo(f"error: the output of this command, or a file, cannot be written ({err.strerror}).", err=True)
    elif err.errno != errno.EPIPE:  # else nobody reads any more what `watch` writes
        return None
    # What is left to be written must not fail again as Python ends.
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return ExitStatus.FAILED
