"""`bagassets build`: bring the dataset up to date."""

import os
import sys
from pathlib import Path

import click

__all__ = ["build"]


@click.command(
    epilog="""\b
Examples:
  bagassets build
  bagassets build --recipe project/recipe.yaml --jobs 4
  bagassets build --retry-failed
"""
)
@click.option("--recipe", type=click.Path(path_type=Path), default=Path("recipe.yaml"), show_default=True,
              help="Recipe of the project.")  # fmt: skip
@click.option("--jobs", type=click.IntRange(min=1), default=os.cpu_count() or 1, show_default="processors",
              help="Recordings worked on at the same time.")  # fmt: skip
@click.option("--retry-failed", is_flag=True, help="Try again what failed before on the same input.")
def build(recipe: Path, jobs: int, retry_failed: bool) -> None:
    """Bring all recordings and the dataset up to date, and tell what was done."""
    from bagassets.defs import driver  # noqa: PLC0415  (Dagster takes a second to import)

    def show(event: driver.Event) -> None:
        name = event.key or "dataset"
        click.echo(f"{event.kind:>8}  {name}" + (f": {event.message}" if event.message else ""))

    report = driver.build(recipe.absolute(), jobs=jobs, retry_failed=retry_failed, on_event=show)
    for key, reason in sorted(report.skipped.items()):
        click.echo(f" skipped  {key}: {reason}")
    for key in report.removed:
        click.echo(f" removed  {key}")
    click.echo(
        f"{len(report.built)} built, {len(report.fresh)} fresh, {len(report.skipped)} skipped, "
        f"{len(report.failed)} failed; dataset {report.dataset}."
    )
    if report.failed:
        for key, sentence in sorted(report.failed.items()):
            click.echo(f"  failed  {key}: {sentence}", err=True)
        sys.exit(1)
