"""`bagassets docs`: the references in `docs/`, generated."""

import click

from bagassets.cli.terminal import echo_lines

__all__ = ["docs"]


@click.group(
    epilog="""\b
Examples:
  bagassets docs recipe
  bagassets docs cli > docs/cli.md"""
)
def docs() -> None:
    """Print reference documentation as Markdown."""


@docs.command(
    epilog="""\b
Examples:
  bagassets docs recipe
  bagassets docs recipe > docs/recipe.md"""
)
def recipe() -> None:
    """Print all fields of the recipe with type, default and meaning."""
    from bagassets.recipe.reference import render_reference  # noqa: PLC0415  (pydantic)

    echo_lines(render_reference(), nl=False)


@docs.command(
    epilog="""\b
Examples:
  bagassets docs cli
  bagassets docs cli > docs/cli.md"""
)
def cli() -> None:
    """Print the help of all commands."""
    from bagassets.cli.reference import render_reference  # noqa: PLC0415  (imports every command)

    echo_lines(render_reference(), nl=False)
