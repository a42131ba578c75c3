"""`bagassets build`: bring the dataset up to date."""

import os
import sys
from pathlib import Path

import click

from bagassets.cli.options import recipe_option

__all__ = ["build"]

EXIT_INTERRUPTED = 130


@click.command(
    epilog="""\b
Examples:
  bagassets build
  bagassets build --recipe project/recipe.yaml --jobs 4
  bagassets build --retry-failed

\b
Exit status: 0 all is up to date, 1 a recording or the dataset failed (the others are done),
2 wrong usage, 130 interrupted."""
)
@recipe_option
@click.option("--jobs", type=click.IntRange(min=1), default=os.cpu_count() or 1, show_default="processors",
              help="Recordings worked on at the same time.")  # fmt: skip
@click.option("--retry-failed", is_flag=True, help="Try again what failed before on the same input.")
def build(recipe: Path, jobs: int, retry_failed: bool) -> None:
    """Bring all recordings and the dataset up to date, and tell what was done."""
    from bagassets.cli.progress import progress_for  # noqa: PLC0415  (not for --help)
    from bagassets.cli.summary import MOST_ROWS, print_summary, summary_rows  # noqa: PLC0415
    from bagassets.defs import driver  # noqa: PLC0415  (Dagster takes a second to import)
    from bagassets.engine.build_report import BuildOptions  # noqa: PLC0415
    from bagassets.recipe import load_recipe  # noqa: PLC0415

    recipe = recipe.absolute()
    store = load_recipe(recipe).store_path
    options = BuildOptions(jobs, retry_failed)
    with progress_for() as show:
        report = driver.build(recipe, options, show)
    print_summary(report, summary_rows(report, store, most=MOST_ROWS), recipe)
    if report.interrupted:
        sys.exit(EXIT_INTERRUPTED)
    if not report.succeeded:
        sys.exit(1)
