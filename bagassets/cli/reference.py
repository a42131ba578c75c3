"""The reference of all commands as Markdown, rendered from their own help."""

from collections.abc import Iterator

import click

from bagassets.cli.main import root

__all__ = ["all_commands", "render_reference"]

_WIDTH = 96

_INTRODUCTION = """\
# The command line

<!-- Generated from the commands' help by `bagassets docs cli`; do not edit. -->

Results go to standard output, progress and errors to standard error. Exit status: 0 success; 1 an error that
the message says how to mend; 2 wrong usage; 70 a defect of bagassets, whose traceback is in the file that the message
names; 130 interrupted.
"""


def all_commands() -> Iterator[tuple[str, click.Command]]:
    """Yield every command with its full name, `bagassets` first."""
    yield from _walk(root, "bagassets", None)


def render_reference() -> str:
    """Return the help of every command as Markdown."""
    parts = [_INTRODUCTION]
    for name, command in all_commands():
        # A fixed width, whatever terminal this runs in; environment and defaults are those of the help.
        context = click.Context(
            command,
            info_name=name,
            terminal_width=_WIDTH,
            max_content_width=_WIDTH,
            help_option_names=["-h", "--help"],
        )
        parts.append(f"\n## {name}\n\n```text\n{command.get_help(context)}\n```\n")
    return "".join(parts)


def _walk(
    command: click.Command, name: str, parent: click.Context | None
) -> Iterator[tuple[str, click.Command]]:
    yield name, command
    if isinstance(command, click.Group):
        context = click.Context(command, info_name=name, parent=parent)
        for child in command.list_commands(context):
            found = command.get_command(context, child)
            if found is not None:
                yield from _walk(found, f"{name} {child}", context)
