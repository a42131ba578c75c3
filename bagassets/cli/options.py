"""Options that several commands share."""

from pathlib import Path

import click

__all__ = ["EXIT_FOUND", "recipe_option"]

EXIT_FOUND = 3
"""Exit status of a check with findings: damage, a mismatch, a difference."""

recipe_option = click.option(
    "--recipe",
    type=click.Path(path_type=Path),
    default=Path("recipe.yaml"),
    show_default=True,
    metavar="FILE",
    help="Recipe of the project.",
)
