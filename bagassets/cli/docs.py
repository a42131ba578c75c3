"""`bagassets docs`: references generated from the recipe's model, the assets and the commands' own help, and the pages of `docs/`."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

import click

from bagassets.cli.terminal import echo, echo_lines

if TYPE_CHECKING:
    from bagassets.assets.asset import AnyAsset

__all__ = ["all_commands", "asset_reference", "command_reference", "docs"]

_WIDTH = 96

_INTRODUCTION = """\
# The command line

<!-- Generated from the commands' help by `bagassets docs cli`; do not edit. -->

Results go to standard output, progress and errors to standard error. Exit status: 0 success; 1 an error that
the message says how to mend; 2 wrong usage; 70 a defect of bagassets, whose traceback is in the file that the message
names; 130 interrupted.
"""

_ASSETS_INTRODUCTION = """\
# The assets of a recording

<!-- Generated from the assets by `bagassets docs assets`; do not edit. -->

Each recording has these, in the order in which they are made; the recording itself is the asset `bag`. How it is decided what
to make anew is said in [how it decides](how-it-decides.md). A new version, of the asset or of a library that shapes its bytes, makes it anew
for all recordings.
"""


@click.group(
    epilog="""\b
Examples:
  bagassets docs recipe
  bagassets docs cli > docs/cli.md"""
)
def docs() -> None:
    """Print documentation as Markdown: references, and pages about one subject each."""


@docs.command(
    epilog="""\b
Examples:
  bagassets docs recipe
  bagassets docs recipe > docs/recipe.md"""
)
def recipe() -> None:
    """Print all fields of the recipe with type, default and meaning."""
    from bagassets.recipe.reference import render_reference

    echo_lines(render_reference(), nl=False)


@docs.command(
    epilog="""\b
Examples:
  bagassets docs assets
  bagassets docs assets > docs/assets.md"""
)
def assets() -> None:
    """Print the assets that recordings have: what each holds and reads."""
    echo_lines(asset_reference(), nl=False)


@docs.command(
    epilog="""\b
Examples:
  bagassets docs cli
  bagassets docs cli > docs/cli.md"""
)
def cli() -> None:
    """Print the help of all commands."""
    echo_lines(command_reference(), nl=False)


@docs.command(
    epilog="""\b
Examples:
  bagassets docs checks"""
)
def checks() -> None:
    """Print the checks of recordings as a table: what each is about, and when it fails."""
    from bagassets.formats.checking import render_checks

    echo_lines(render_checks(), nl=False)


@docs.command(
    epilog="""\b
Examples:
  bagassets docs page
  bagassets docs page formats | less"""
)
@click.argument("name", required=False)
def page(name: str | None) -> None:
    """Print a page of the documentation, or without NAME the list of them."""
    from bagassets.cli.pages import find_pages, page_title

    pages = find_pages()
    if name is None:
        width = max(map(len, pages))
        for known, path in pages.items():
            echo(f"{known:{width}}  {page_title(path)}")
        echo(f"They lie in {next(iter(pages.values())).parent}")
    elif name not in pages:
        raise click.BadParameter(f"no page {name!r}; there are {', '.join(pages)}.", param_hint="NAME")
    else:
        echo_lines(pages[name].read_text(encoding="utf-8"), nl=False)


def all_commands() -> Iterator[tuple[str, click.Command]]:
    """Yield every command with its full name, `bagassets` first."""
    from bagassets.cli.main import root

    yield from _walk(root, "bagassets", None)


def command_reference() -> str:
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


def asset_reference() -> str:
    """Return what there is to know of every asset, those of installed packages included."""
    from bagassets.formats.catalogue import known_assets

    assets = known_assets()
    return _ASSETS_INTRODUCTION + "".join(_section(asset, assets) for asset in assets)


def _section(asset: "AnyAsset", assets: "tuple[AnyAsset, ...]") -> str:
    from bagassets.formats.catalogue import formats

    readers = [other.name for other in assets if asset.name in {one.name for one in other.reads}]
    rows = {
        "reads": _names([one.name for one in asset.reads] or ["bag"]),
        "is read by": _names(readers),
        "datasets made of it": _names([kind.name for kind in formats() if kind.part == asset.name]),
        "made with it": _names([one.name for one in asset.along]),
        "one artifact for each": "" if asset.extract is None else "channel",
        "decoder plug-ins": ", ".join(asset.families),
        "libraries": ", ".join(asset.libraries),
        "version": str(asset.version),
        "if it fails": "the recording still enters datasets that are not made of it"
        if asset.optional
        else "",
    }
    table = "".join(f"| {what} | {said} |\n" for what, said in rows.items() if said)
    return f"\n## {asset.name}\n\n{asset.about}\n\n| | |\n|---|---|\n{table}"


def _names(names: list[str]) -> str:
    return ", ".join(f"`{name}`" for name in names)
