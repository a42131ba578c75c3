"""Options that several commands share."""

from pathlib import Path

import click

__all__ = ["recipe_option"]

recipe_option = click.option(
    "--recipe",
    type=click.Path(path_type=Path),
    default=Path("recipe.yaml"),
    show_default=True,
    metavar="FILE",
    help="Recipe of the project.",
)
