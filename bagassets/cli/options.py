"""Options that several commands share."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

recipe_option = click.option(
    "--recipe",
    type=click.Path(path_type=Path),
    default=Path("recipe.yaml"),
    show_default=True,
    metavar="FILE",
    help="Recipe of the project.",
)


class Number(click.FloatRange):
    """A number in a range, which `inf` and `nan` never are."""

    def convert(self, value: Any, param: Any, ctx: Any) -> float:  # noqa: ANN401  (as click has it)
        """Return the number, or fail."""
        number: float = super().convert(value, param, ctx)
        return number if math.isfinite(number) else self.fail(f"{value!r} is not a number.", param, ctx)


def index_option(what: str) -> Callable[[Any], Any]:
    """Return the option for a recipe whose index takes digests; without it, the one in the current folder counts.

    Args:
        what: happens to its recordings, and when.
    """
    return click.option(
        "--recipe",
        type=click.Path(path_type=Path),
        metavar="FILE",
        default=lambda: path if (path := Path("recipe.yaml")).is_file() else None,
        help=f"Recipe whose recordings are {what}, and whose index takes the digests of files without extended "
        "attributes; default: recipe.yaml in the current folder, if there is one.",
    )
