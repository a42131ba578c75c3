"""`bagassets docs`: references generated from the model of the recipe, the assets and the help of commands; pages of `docs/`."""

from collections.abc import Iterator
from functools import partial
from importlib import import_module
from importlib.metadata import PackageNotFoundError, files
from pathlib import Path
from typing import TYPE_CHECKING

import click

import bagassets
from bagassets.base.errors import BagAssetsError
from bagassets.cli.terminal import echo, echo_lines

if TYPE_CHECKING:
    from bagassets.assets.asset import AnyAsset


_WIDTH = 96
_CHECKOUT = Path(bagassets.__file__).parents[1]
_INSTALLED = "share/doc/bagassets/docs"  # as pyproject.toml has it

_INTRODUCTION = """\
# The command line

<!-- Generated from the commands' help by `bagassets docs cli`; do not edit. -->

Results go to standard output, progress and errors to standard error. Exit status: 0 success; 1 an error, whose
message says how to fix it; 2 wrong usage; 70 a defect of bagassets, whose message names the file with the traceback;
130 interrupted.
"""

_ASSETS_INTRODUCTION = """\
# The assets of a recording

<!-- Generated from the assets by `bagassets docs assets`; do not edit. -->

The assets of each recording, in the order in which they are made; the recording itself is the asset `bag`. [How it decides](how-it-decides.md)
says what is made again after which change. A new version of an asset, or of a library that shapes its bytes, rebuilds it for all recordings.
"""


@click.group(
    epilog="""\b
Examples:
  bagassets docs recipe
  bagassets docs cli > docs/cli.md"""
)
def docs() -> None:
    """Print documentation as Markdown: references, and pages about one subject each."""


def _print_reference(module: str, function: str) -> None:
    echo_lines(getattr(import_module(module), function)(), nl=False)


# Name -> help of the command that prints a reference, and what returns the text; only of the checks there is no page.
for _name, (_about, *_source) in {
    "recipe": (
        "Print all fields of the recipe with type, default and meaning.",
        "bagassets.recipe.reference",
        "render_reference",
    ),
    "assets": (
        "Print the assets that recordings have: what each holds and reads.",
        "bagassets.cli.docs",
        "asset_reference",
    ),
    "cli": ("Print the help of all commands.", "bagassets.cli.docs", "command_reference"),
    "checks": ("Print the checks of recordings as a table.", "bagassets.formats.checking", "render_checks"),
}.items():
    _kept = "" if _name == "checks" else f"\n  bagassets docs {_name} > docs/{_name}.md"
    _epilog = f"\b\nExamples:\n  bagassets docs {_name}{_kept}"
    _print = partial(_print_reference, *_source)
    docs.add_command(click.Command(_name, callback=_print, help=_about, epilog=_epilog))


@docs.command(
    epilog="""\b
Examples:
  bagassets docs page
  bagassets docs page formats | less"""
)
@click.argument("name", required=False)
def page(name: str | None) -> None:
    """Print a page of the documentation; without NAME, list the pages."""
    pages = find_pages()
    if name is None:
        width = max(map(len, pages))
        for known, path in pages.items():
            echo(f"{known:{width}}  {_page_title(path)}")
        echo(f"They are in {next(iter(pages.values())).parent}")
    elif name not in pages:
        raise click.BadParameter(f"no page {name!r}; the pages are {', '.join(pages)}.", param_hint="NAME")
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
        # A fixed width, whatever terminal this runs in.
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
            if (found := command.get_command(context, child)) is not None:
                yield from _walk(found, f"{name} {child}", context)


def asset_reference() -> str:
    """Return a section on every asset, those of installed packages included, as Markdown."""
    from bagassets.formats.catalogue import known_assets

    assets = known_assets()
    return _ASSETS_INTRODUCTION + "".join(_section(asset, assets) for asset in assets)


def reads_of(asset: "AnyAsset") -> str:
    """Return the names of what an asset reads, as Markdown."""
    return _names([one.name for one in asset.reads] or ["bag"])


def parameters_of(asset: "AnyAsset") -> str:
    """Return the names of the parameters that an asset takes from a recipe, as Markdown."""
    from typing import get_args, get_type_hints

    returned = get_type_hints(asset.params)["return"]
    owner = getattr(asset.params, "__self__", None)  # a classmethod of the parameters themselves
    kinds = [owner] if owner is not None else [*get_args(returned)] or [returned]
    names = [name for kind in kinds for name in _fields_of(kind)]
    return _names(list(dict.fromkeys(names)))


def _fields_of(kind: object) -> list[str]:
    """Return the names of the fields of a dataclass or of a recipe model."""
    from dataclasses import fields, is_dataclass

    from pydantic import BaseModel

    if is_dataclass(kind):
        return [one.name for one in fields(kind)]
    return list(kind.model_fields) if isinstance(kind, type) and issubclass(kind, BaseModel) else []


def _section(asset: "AnyAsset", assets: "tuple[AnyAsset, ...]") -> str:
    from bagassets.formats.catalogue import formats

    readers = [other.name for other in assets if asset.name in {one.name for one in other.reads}]
    rows = {
        "reads": reads_of(asset),
        "read by": _names(readers),
        "datasets made from it": _names([kind.name for kind in formats() if kind.part == asset.name]),
        "made with it": _names([one.name for one in asset.along]),
        "one artifact per": "" if asset.extract is None else "channel" if asset.families else "signal",
        "parameters": parameters_of(asset),
        "decoder plug-ins": ", ".join(asset.families),
        "libraries": ", ".join(asset.libraries),
        "version": str(asset.version),
        "what versions changed": "; ".join(f"{version} {text}" for version, text in asset.changes.items()),
        "if it fails": "the recording still enters datasets that are not made from it"
        if asset.optional
        else "",
    }
    table = "".join(f"| {name} | {value} |\n" for name, value in rows.items() if value)
    return f"\n## {asset.name}\n\n{asset.about}\n\n| | |\n|---|---|\n{table}"


def _names(names: list[str]) -> str:
    return ", ".join(f"`{name}`" for name in names)


def find_pages() -> dict[str, Path]:
    """Return the pages by name.

    Raises:
        BagAssetsError: there are none.
    """
    found = {path.stem: path for path in sorted(_in_checkout() or _in_wheel())}
    if not found:
        raise BagAssetsError(
            "documentation: there are no pages; a checkout has them in docs/, and pip installs them with a wheel of bagassets."
        )
    return found


def _page_title(page: Path) -> str:
    """Return the first heading of a page."""
    lines = page.read_text(encoding="utf-8").splitlines()
    return next((line.removeprefix("# ") for line in lines if line.startswith("# ")), page.stem)


def _in_checkout() -> list[Path]:
    # Beside an installed package there may be folders of others.
    return list((_CHECKOUT / "docs").glob("*.md")) if (_CHECKOUT / "pyproject.toml").is_file() else []


def _in_wheel() -> Iterator[Path]:
    try:
        installed = files("bagassets") or []
    except PackageNotFoundError:
        return
    for file in installed:
        if file.parent.as_posix().endswith(_INSTALLED) and file.suffix == ".md":
            path = Path(str(file.locate())).resolve()
            if path.is_file():
                yield path
