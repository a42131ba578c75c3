"""`bagassets formats`: dataset formats, and assets of recordings that installed packages add."""

import click

from bagassets.cli.terminal import echo, echo_lines

__all__ = ["formats"]


@click.command(
    epilog="""\b
Examples:
  bagassets formats
  bagassets formats --json | jq -r '.formats[].name'"""
)
@click.option("--json", "as_json", is_flag=True, help="Print names, versions, packages and problems as JSON.")
def formats(as_json: bool) -> None:
    """List dataset formats, and assets of recordings that packages add.

    A package adds them by entry points of the groups bagassets.formats and bagassets.assets;
    `bagassets docs page formats` says how. The exit status is 1 if one of them cannot be used.
    """
    import json

    from bagassets.formats.catalogue import catalogue

    found = catalogue()
    rows = [
        {
            "name": kind.name,
            "version": kind.version,
            "section": kind.section,
            "part": kind.part,
            "package": kind.distribution or None,
        }
        for kind in found.formats
    ]
    assets = [
        {"name": name, "version": asset.version, "package": asset.distribution}
        for name, asset in found.assets.items()
    ]
    if as_json:
        told = {"formats": rows, "assets": assets, "problems": list(found.problems)}
        echo_lines(json.dumps(told, indent=2))
    else:
        for kind in found.formats:
            owner = f", from {kind.distribution}" if kind.distribution else ""
            echo(
                f"format {kind.name} {kind.version}: `{kind.section}` in the recipe, made from {kind.part}{owner}"
            )
        for name, asset in found.assets.items():
            echo(f"asset {name} {asset.version}: from {asset.distribution}")
        for problem in found.problems:
            echo_lines(f"error: {problem}", err=True)
    if found.problems:
        click.get_current_context().exit(1)
