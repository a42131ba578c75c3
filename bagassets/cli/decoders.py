"""`bagassets decoders`: the decoder plug-ins of this Python environment."""

import click

from bagassets.cli.terminal import echo, echo_lines

__all__ = ["decoders"]


@click.command(
    epilog="""\b
Examples:
  bagassets decoders
  bagassets decoders --json | jq -r '.decoders[].type'"""
)
@click.option("--json", "as_json", is_flag=True, help="Print names, types, packages and problems as JSON.")
def decoders(as_json: bool) -> None:
    """List installed decoders of your own message types.

    A package adds one by an entry point of the group bagassets.decoders; `bagassets docs
    page decoders` says how. Nothing of the packages is imported. The exit status is 1 if one of them
    cannot be used.
    """
    import json

    from bagassets.decode.registry import find_decoder
    from bagassets.errors import PluginError
    from bagassets.plugins import installed_decoders

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
    if as_json:
        echo_lines(json.dumps({"decoders": rows, "problems": problems}, indent=2))
    elif rows:
        table = [("type", "becomes", "package", "decoder")]
        table += [
            (row["type"], row["family"], f"{row['distribution']} {row['version']}", row["object"])
            for row in rows
        ]
        widths = [max(len(row[i]) for row in table) for i in range(4)]
        for row in table:
            echo("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())
    elif not problems:
        echo(
            "No decoder plug-ins are installed; `bagassets docs page decoders` lists the types that need none."
        )
    if problems and not as_json:
        for problem in problems:
            echo_lines(f"error: {problem}", err=True)
    if problems:
        click.get_current_context().exit(1)
