"""Printing for commands: names come from recordings, so everything that a terminal would obey is escaped."""

from typing import TYPE_CHECKING

import click

from bagassets.escaping import terminal, visible

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["echo", "echo_lines", "print_lines"]


def echo(line: str, *, err: bool = False) -> None:
    """Print one line; line breaks, which can only be part of a name, are spelled out."""
    click.echo(visible(line), err=err)


def echo_lines(text: str, *, err: bool = False, nl: bool = True) -> None:
    """Print several lines in which no name has a line break: JSON, tables, error messages."""
    click.echo(terminal(text), err=err, nl=nl)


def print_lines(console: "Console", text: str) -> None:
    """Print lines as `echo_lines` does, on a console of rich."""
    console.print(terminal(text), markup=False, soft_wrap=True)
