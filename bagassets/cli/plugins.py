"""`bagassets decoders` and `bagassets formats`: what installed packages add."""

from collections.abc import Sequence

import click

from bagassets.base.json_types import JsonObject
from bagassets.cli.exit_status import ExitStatus
from bagassets.cli.terminal import echo, echo_json, echo_lines

_json_option = click.option(
    "--json", "as_json", is_flag=True, help="Print names, packages, versions and problems as JSON."
)


@click.command(
    epilog="""\b
Examples:
  bagassets decoders
  bagassets decoders --json | jq -r '.decoders[].type'"""
)
@_json_option
def decoders(as_json: bool) -> None:
    """List installed decoders for your own message types.

    A package adds a decoder with an entry point of the group bagassets.decoders; see `bagassets docs page decoders`. The
    packages are not imported. The exit status is 1 if a decoder cannot be used.
    """
    from bagassets.base.errors import PluginError
    from bagassets.base.plugins import installed_decoders
    from bagassets.decode.registry import find_decoder

    installed = installed_decoders()
    problems = list(installed.unusable)
    rows = []
    for plugin in installed.plugins:
        try:
            find_decoder(plugin.family, plugin.msgtype)
        except PluginError as err:
            if str(err) not in problems:
                problems.append(str(err))
        rows.append(
            {"name": plugin.name, "family": plugin.family, "type": plugin.msgtype, **plugin.as_json()}
        )
    if rows:
        table = [("type", "becomes", "package", "decoder")]
        table += [(r["type"], r["family"], f"{r['distribution']} {r['version']}", r["object"]) for r in rows]
        lines = _table(table)
    else:
        nothing = "No decoder plug-ins are installed; `bagassets docs page decoders` lists the types that need none."
        lines = [] if problems else [nothing]
    _print({"decoders": rows}, lines, problems, as_json=as_json)


@click.command(
    epilog="""\b
Examples:
  bagassets formats
  bagassets formats --json | jq -r '.formats[].name'"""
)
@_json_option
def formats(as_json: bool) -> None:
    """List dataset formats, and the assets of recordings that packages add.

    A package adds them with entry points of the groups bagassets.formats and bagassets.assets; see `bagassets docs
    page formats`. The exit status is 1 if one of them cannot be used.
    """
    from bagassets.formats.catalogue import catalogue

    known = catalogue()
    value = {
        "formats": [
            {name: getattr(kind, name) for name in ("name", "version", "section", "part")}
            | {"package": kind.distribution or None}
            for kind in known.formats
        ],
        "assets": [
            {"name": name, "version": asset.version, "package": asset.distribution}
            for name, asset in known.assets.items()
        ],
    }
    lines = [
        f"format {kind.name} {kind.version}: `{kind.section}` in the recipe, made from {kind.part}"
        + (f", from {kind.distribution}" if kind.distribution else "")
        for kind in known.formats
    ]
    lines += [
        f"asset {name} {asset.version}: from {asset.distribution}" for name, asset in known.assets.items()
    ]
    _print(value, lines, known.problems, as_json=as_json)


def _table(rows: Sequence[tuple[str, ...]]) -> list[str]:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
    ]


def _print(value: JsonObject, lines: Sequence[str], problems: Sequence[str], *, as_json: bool) -> None:
    """Print a list and its problems; exit with 1 if there are any."""
    if as_json:
        echo_json({**value, "problems": list(problems)})
    else:
        for line in lines:
            echo(line)
        for problem in problems:
            echo_lines(f"error: {problem}", err=True)
    if problems:
        click.get_current_context().exit(ExitStatus.FAILED)
