"""`bagassets report`: one page about the whole dataset."""

from pathlib import Path

import click

from bagassets.base.quantities import count_text, readable_bytes
from bagassets.cli.options import recipe_option
from bagassets.cli.terminal import echo, echo_json


@click.command(
    epilog="""\b
Examples:
  bagassets report
  bagassets report --output /srv/www/drives.html --no-checks
  bagassets report --json | jq '.recordings[] | select(.state == "failed")'"""
)
@recipe_option
@click.option(
    "--output",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="FILE",
    help="File to write; default: report.html beside the recipe.",
)
@click.option(
    "--no-checks",
    is_flag=True,
    help="Leave out the checks, which take most of the time with many recordings.",
)
@click.option(
    "--json", "as_json", is_flag=True, help="Print the content of the page as JSON, and write no page."
)
def report(recipe: Path, output: Path | None, no_checks: bool, as_json: bool) -> None:
    """Write one HTML page about the dataset: recordings, splits, checks, classes, gaps, losses, pictures, map.

    The page is self-contained, pictures included, and loads nothing. Nothing is built: the page shows the present state.
    """
    from bagassets.cli.progress import bar_shown, planning_shown
    from bagassets.defs.builds.pending_work import open_project
    from bagassets.defs.records.instance_plan import planner_of
    from bagassets.formats.report_data import report_data
    from bagassets.report.page import report_json, report_page
    from bagassets.report.write import write_page

    with planning_shown() as on_planned, open_project(recipe) as workspace:
        plan = planner_of(workspace).plan(on_planned)
    with bar_shown("Reading recordings", len(plan.bags)) as on_read:
        data = report_data(workspace.assets, plan, "nothing" if no_checks else "all", on_read)
    if as_json:
        echo_json(report_json(data))
        return
    path = output or recipe.absolute().parent / "report.html"
    size = write_page(path, report_page(data))
    echo(f"{path} ({count_text(len(data.recordings), 'recording')}, {readable_bytes(size)})")
