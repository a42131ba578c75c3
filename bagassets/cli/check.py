"""`bagassets check`: run the asset checks with the current thresholds of the recipe."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from bagassets.base.alike import told_once
from bagassets.base.errors import SelectionError
from bagassets.base.escaping import visible
from bagassets.base.quantities import count_text
from bagassets.cli.exit_status import ExitStatus
from bagassets.cli.options import recipe_option
from bagassets.cli.terminal import echo, echo_json, echo_lines

if TYPE_CHECKING:
    from bagassets.formats.checking import Verdict

_MOST_PROBLEMS = 5


@click.command(
    epilog="""\b
Examples:
  bagassets check
  bagassets check --bag 'monday*'
  bagassets check --json | jq '.[] | select(.passed == false) | .problems[0]'

\b
Exit status:
  0  no check of severity error failed, and no recording
  1  a recording failed on its current input, or something is wrong with the recipe or a folder
  3  a check of severity error failed"""
)
@recipe_option
@click.option("--bag", "bags", multiple=True, metavar="BAG",
              help="Only this recording: its key, a glob of keys, or its path; may be repeated. Leaves out the dataset.")  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print all verdicts as a JSON list.")
def check(recipe: Path, bags: tuple[str, ...], as_json: bool) -> int:
    """Run the checks of the recipe on what was built, and print the findings.

    These are the asset checks of the web UI, with the current thresholds of the recipe. Nothing is built, and nothing
    is recorded in Dagster.
    """
    from bagassets.cli.progress import bar_shown, planning_shown
    from bagassets.defs.builds.pending_work import find_pending_work, open_project
    from bagassets.engine.build_report import BuildOptions
    from bagassets.formats.checking import check_bags, check_datasets

    try:
        with planning_shown() as on_planned, open_project(recipe) as workspace:
            pending = find_pending_work(workspace, BuildOptions(bags=bags), on_planned=on_planned)
    except SelectionError as err:
        raise click.UsageError(str(err)) from err
    bags_chosen = [pending.plan.bags[key] for key in sorted(pending.asked.chosen)]
    verdicts: list[Verdict] = []
    with bar_shown("Checking recordings", len(bags_chosen)) as on_checked:
        for _, found in check_bags(workspace.assets, pending.plan, bags_chosen):
            verdicts += found
            on_checked(1)
    if not bags:
        verdicts += check_datasets(workspace.recipe)
    if as_json:
        echo_json([verdict.as_json() for verdict in verdicts])
    else:
        skipped = {
            key: pending.plan.bags[key].skipped for key in sorted(pending.asked.chosen if bags else ())
        }
        for told in told_once(((), key, why) for key, why in skipped.items() if why is not None):
            echo_lines(f"skipped {told.title}: {told.text}")
        _print(verdicts)
    for told in told_once(((), key, reason) for key, reason in pending.failed.items()):
        echo_lines(f"failed {told.title}: {told.text}", err=True)
    if any(verdict.is_error for verdict in verdicts):
        return ExitStatus.FOUND
    return ExitStatus.FAILED if pending.failed else 0


def _print(verdicts: Sequence["Verdict"]) -> None:
    counts = {"passed": 0, "warn": 0, "error": 0, "not made yet": 0}
    found = []
    for verdict in verdicts:
        finding = verdict.finding
        counts["not made yet" if finding is None else "passed" if finding.passed else verdict.weight] += 1
        if finding is not None and not finding.passed:
            first, more = finding.sentences[:_MOST_PROBLEMS], finding.sentences[_MOST_PROBLEMS:]
            problems = "\n".join([*map(visible, first), *([f"and {len(more)} more"] if more else [])])
            found.append(((verdict.weight, verdict.check), verdict.recording or "", problems))
    for told in told_once(found):
        weight, check = told.kind
        click.secho(f"{weight:5}", fg="red" if weight == "error" else "yellow", nl=False)
        echo(f" {told.title or 'dataset'}: {check}")
        for problem in told.text.split("\n"):
            echo(f"      {problem}")
    counted = ", ".join(f"{number} {what}" for what, number in counts.items() if number)
    echo(f"{count_text(len(verdicts), 'check')}: {counted or 'none'}.")
