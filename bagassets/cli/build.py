"""`bagassets build`: bring the dataset up to date."""

import os
import sys
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import click

from bagassets.base.errors import SelectionError
from bagassets.base.json_types import JsonObject
from bagassets.base.quantities import count_text
from bagassets.cli.early import JOBS_PER_PROCESSOR, MOST_ROWS, HandedOver
from bagassets.cli.exit_status import ExitStatus
from bagassets.cli.options import recipe_option
from bagassets.cli.progress import planning_shown, progress_for
from bagassets.cli.terminal import echo, echo_json, echo_lines

if TYPE_CHECKING:
    from bagassets.engine.build_report import BuildOptions, Event


@click.command(
    epilog="""\b
Examples:
  bagassets build
  bagassets build --recipe project/recipe.yaml --jobs 4
  bagassets build --bag 'monday*' --select frames,sweeps
  bagassets build --select train                # an asset of your own that does not run by itself
  bagassets build --dry-run
  bagassets build --check || echo stale
  bagassets build --trace trace.json            # open it with https://ui.perfetto.dev

\b
Exit status:
    0  everything asked for is up to date
    1  a recording or a dataset failed (the others are done), a dataset has nothing of its recordings, or something is
       wrong with the recipe or a disk
    2  wrong usage
    3  --check: there is something to do
  130  interrupted; what was finished is kept"""
)
@recipe_option
@click.option("--bag", "bags", multiple=True, metavar="BAG",
              help="Only this recording: its key, a glob of keys, or its path; may be repeated.")  # fmt: skip
@click.option("--select", multiple=True, metavar="ASSETS",
              help="Only these assets, also of your own, and what they depend on, separated by commas; default: all.")  # fmt: skip
@click.option("--jobs", "-j", type=click.IntRange(min=1), default=os.cpu_count() or 1,
              show_default="processors", help="How many recordings to build at the same time; at most two per processor.")  # fmt: skip
@click.option("--retry-failed", is_flag=True, help="Retry what failed before on the same input.")
@click.option("--allow-empty", is_flag=True,
              help="Accept a bag root without recordings where there were some before; the dataset becomes empty.")  # fmt: skip
@click.option("--ignore-disk-space", is_flag=True, help="Build even if the disk seems to be too small.")
@click.option("--dry-run", "-n", is_flag=True, help="Show what would run, and why; run nothing.")
@click.option(
    "--check", is_flag=True, help="Run nothing; exit with 0 if everything is fresh, with 3 if not (for CI)."
)
@click.option("--trace", type=click.Path(dir_okay=False, path_type=Path), metavar="FILE",
              help="Write a trace of recordings, steps and workers over time, for Chrome or Perfetto.")  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print the report as JSON; progress goes to stderr.")
def build(
    recipe: Path,
    bags: tuple[str, ...],
    select: tuple[str, ...],
    jobs: int,
    retry_failed: bool,
    allow_empty: bool,
    ignore_disk_space: bool,
    dry_run: bool,
    check: bool,
    trace: Path | None,
    as_json: bool,
) -> None:
    """Bring all recordings and the dataset up to date, and report what was done.

    Only what is stale runs; a recording that fails does not stop the others. Assets of your own that read these and would
    run by themselves come last.
    """
    from bagassets.cli.remote import InterruptedBuildError
    from bagassets.engine.build_report import BuildOptions

    recipe = recipe.absolute()
    options = BuildOptions(_limited(jobs), retry_failed, bags, select, allow_empty, ignore_disk_space)
    try:
        if dry_run or check:
            sys.exit(_dry_run(recipe, options, check=check, as_json=as_json))
        sys.exit(_build(recipe, options, trace, as_json=as_json))
    except SelectionError as err:
        raise click.UsageError(str(err)) from err
    except InterruptedBuildError as err:
        raise click.Abort from err


def _limited(jobs: int) -> int:
    most = JOBS_PER_PROCESSOR * (os.cpu_count() or 1)
    if jobs > most:
        processors = count_text(os.cpu_count() or 1, "processor")
        echo(f"--jobs {jobs}: this machine has {processors}; using {most}.", err=True)
    return min(jobs, most)


def _build(recipe: Path, options: "BuildOptions", trace: Path | None, *, as_json: bool) -> int:
    from bagassets.cli.summary import print_summary
    from bagassets.engine.build_report import BuildReport, SummaryRow

    handed_over = click.get_current_context().find_object(HandedOver)
    value = build_with_progress(recipe, options, trace, None if as_json else MOST_ROWS, handed_over)
    report = BuildReport.from_json(value)
    if as_json:
        echo_json(value)
    else:
        print_summary(report, [SummaryRow.from_json(row) for row in value["summary"]], recipe)
    if report.interrupted:
        return ExitStatus.INTERRUPTED
    return 0 if report.succeeded else ExitStatus.FAILED


def build_with_progress(
    recipe: Path,
    options: "BuildOptions",
    trace: Path | None,
    most: int | None,
    handed_over: HandedOver | None = None,
) -> JsonObject:
    """Build on the server and show the progress; return the report, with the rows of its table, as JSON."""
    from bagassets.cli.remote import report_of_build

    with ExitStack() as stack:
        listeners: list[Callable[[Event], None]] = [stack.enter_context(progress_for())]
        if trace is not None:
            from bagassets.engine.trace_file import recorded_trace, trace_recordings
            from bagassets.recipe import load_recipe

            stack.enter_context(recorded_trace(trace, load_recipe(recipe).state))
            listeners.append(trace_recordings)

        def on_event(event: "Event") -> None:
            for listener in listeners:
                listener(event)

        return report_of_build(recipe, options, on_event, most, handed_over)


def _dry_run(recipe: Path, options: "BuildOptions", *, check: bool, as_json: bool) -> int:
    """Show what a build would do; return the exit status of --check, or 0 for a dry run."""
    from bagassets.cli.dry_run import dry_run_json, dry_run_lines, verdict
    from bagassets.cli.summary import move_text, print_remarks, summary_console
    from bagassets.defs.builds.own_states import load_own
    from bagassets.defs.builds.pending_work import expected_moves, find_pending_work, open_project
    from bagassets.engine.made_again import made_again
    from bagassets.formats.checking import remarks_on_record
    from bagassets.formats.emptiness import why_empty

    with planning_shown() as on_planned, open_project(recipe) as known_as:
        own = load_own(known_as, options)
        workspace = own.workspace
        pending = find_pending_work(workspace, options, own, on_planned=on_planned)
        surveyed = own.survey(pending)
        moved = expected_moves(pending, workspace.recipe) if pending.asked.datasets else {}
        # Recordings that will be built will also be checked again.
        done = [pending.plan.bags[key] for key in sorted(pending.asked.chosen - pending.todo.keys())]
        remarks = tuple(remarks_on_record(workspace.assets, pending.plan.discovery, done))
        again = made_again(workspace.assets, pending.plan, pending.todo, options.jobs)
        empty = why_empty(workspace.recipe, recipe, workspace.store, pending.asked.datasets)
    if as_json:
        echo_json(dry_run_json(pending, surveyed, moved, remarks))
    else:
        for line in dry_run_lines(pending, surveyed) if not check else ():
            echo_lines(line)
        if again:
            echo_lines(again)
        print_remarks(remarks, summary_console())
        for key, (was, now) in moved.items():
            is_pinned = pending.plan.ties.pinned(key, workspace.recipe.splits) is not None
            echo(f"{key} would move {move_text(was, now, is_pinned=is_pinned)}.")
        if empty and pending.is_settled:
            echo(empty)
        echo(verdict(pending, surveyed))
    if not check:
        return 0
    if not (pending.is_settled and surveyed.is_settled):
        return ExitStatus.FOUND
    return ExitStatus.FAILED if pending.failed or surveyed.failed or empty else 0
