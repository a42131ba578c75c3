"""`bagassets init`: a project folder from a folder of recordings, or from one recording."""

import os
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import click

from bagassets.base.alike import names_text
from bagassets.base.errors import BagAssetsError, RecipeError
from bagassets.base.escaping import visible
from bagassets.base.quantities import count_text
from bagassets.cli.exit_status import ExitStatus
from bagassets.cli.terminal import echo

if TYPE_CHECKING:
    from bagassets.propose.proposal import Proposal
    from bagassets.propose.summary import RecordingSummary


@click.command(
    epilog="""\b
Examples:
  bagassets init my-project --bags /data/recordings
  bagassets init my-project --bags /data/monday.bag           # a project of one recording
  bagassets init my-project --bags /data/recordings --force   # propose anew
  bagassets init my-project                                   # after moving the folder

Exit status: 0 success; 1 no recording is found, or another error; 2 wrong usage, or something is to be decided before
the first build, as when no recording can be read"""
)
@click.argument("project", type=click.Path(file_okay=False, path_type=Path))
@click.option(
    "--bags",
    type=click.Path(exists=True, path_type=Path),
    metavar="PATH",
    help="Folder that holds the recordings, or a single recording.",
)
@click.option(
    "--look-at",
    type=click.IntRange(min=1),
    default=200,
    show_default=True,
    metavar="N",
    help="Look into at most N recordings, spread evenly over those found.",
)
@click.option("--force", is_flag=True, help="Replace the files of a project that is there already.")
def init(project: Path, bags: Path | None, look_at: int, force: bool) -> None:
    """Make a project folder, with a recipe proposed from recordings.

    Writes recipe.yaml, dagster.yaml, workspace.yaml and .env into PROJECT, and definitions.py and
    pyproject.toml for `dg`, Dagster's command line, unless one is there. The recipe is proposed
    from the first seconds of the recordings at PATH: rigs, channels, topics, frames, pose source,
    with a comment for each guess and for what is to be decided before a build can succeed. On a
    terminal it asks whether builds may store digests beside the recordings, as extended attributes;
    elsewhere the recipe has that as a comment.

    Without --bags, recipe.yaml and workspace.yaml of PROJECT are kept and the other files are
    written again, which a project needs after it has been moved.
    """
    from bagassets.cli.init_report import print_found, print_next_steps
    from bagassets.propose.project import FILES, write_project
    from bagassets.recipe import load_recipe

    # A link to the folder may move; where it leads, the state stays.
    project = project.resolve()
    recipe_file = project / "recipe.yaml"
    if bags is None:
        if not recipe_file.is_file():
            raise click.UsageError(
                f"{project} has no recipe.yaml yet; name the folder of the recordings with --bags."
            )
        kept = [name for name in FILES if (project / name).is_file()]
        written = write_project(project, None, load_recipe(recipe_file).state)
        unchanged = ", ".join(name for name in kept if name not in written)
        echo(f"Wrote {', '.join(written)} in {project}; kept {unchanged}.")
        return
    if not force:
        _refuse_to_replace(project, FILES)
    proposal, unreadable = _propose(project, bags.resolve(), look_at)
    if not force:
        _refuse_to_replace(project, proposal.files)
    written = write_project(project, proposal.text, more=proposal.files)
    print_found(proposal, unreadable)
    problems: list[str] = []
    if not proposal.questions:  # a recipe that asks nothing may be wrong otherwise
        try:
            load_recipe(recipe_file)
        except RecipeError as err:
            problems = str(err).splitlines()
    print_next_steps(project, written, proposal, problems)
    if proposal.questions or problems:
        click.get_current_context().exit(ExitStatus.UNDECIDED)


def _refuse_to_replace(project: Path, names: Iterable[str]) -> None:
    if present := [name for name in names if (project / name).exists()]:
        raise RecipeError(
            f"{project}: {', '.join(present)} would be replaced; --force does that, another folder avoids it."
        )


def _propose(project: Path, path: Path, look_at: int) -> "tuple[Proposal, dict[str, str]]":
    """Look into the recordings at `path`; return a recipe, and path -> reason of what could not be read."""
    from bagassets.propose.calibration_files import find_calibrations
    from bagassets.propose.proposal import propose_recipe
    from bagassets.propose.scan import scan_recording
    from bagassets.recipe.model import Bags
    from bagassets.recordings.discover import bags_of_one, discover, series_with
    from bagassets.recordings.salvage.open import read_as_far

    is_one = path.is_file()
    bags = bags_of_one(path) if is_one else Bags(root=path)
    if is_one and (whole := series_with(path)):
        echo(f"{path.name} is part of {whole}; for the whole drive, name the folder.", err=True)
    root = bags.root
    discovery = discover(bags)
    unreadable = {
        path: sentence.removeprefix(f"{root / path}: ") for path, sentence in discovery.unreadable.items()
    }
    recordings = sorted(discovery.recordings.values(), key=lambda recording: recording.relative)
    excluded = () if is_one else discovery.excluded
    reasons = {path: reason for path, reason in excluded if path not in unreadable}
    if not recordings:
        reasons |= unreadable
        raise RecipeError(
            f"{root}: no recording found; expected .bag, .mcap or .db3 files, or ROS 2 bag folders.",
            *(f"{path}: {reason.removesuffix('.')}." for path, reason in sorted(reasons.items())),
        )
    unreadable |= reasons
    # Whether builds may write to recordings; no, where nobody can answer.
    digest_attributes = (
        sys.stdin.isatty()
        and sys.stdout.isatty()
        and click.confirm(
            "Builds only read recordings. Should they store digests beside them (extended attributes),\n"
            "so that other projects and machines need not hash them again?",
            default=False,
        )
    )
    number = min(look_at, len(recordings))  # evenly spread from the first to the last
    chosen = [recordings[i * (len(recordings) - 1) // max(1, number - 1)] for i in range(number)]
    summaries: dict[str, RecordingSummary] = {}
    damaged: list[str] = []
    with click.progressbar(
        chosen,
        label=f"Looking into {count_text(len(chosen), 'recording')}",
        file=sys.stderr,
        item_show_func=lambda recording: visible(recording.relative) if recording else "",
    ) as shown:
        for recording in shown:
            try:
                is_damaged, found = read_as_far(
                    recording, lambda opened: (opened.damage is not None, scan_recording(opened))
                )
                summaries[recording.relative] = found
                if is_damaged:
                    damaged.append(recording.relative)
            except BagAssetsError as err:
                # The build will fail this recording's partition with the same words; others go on.
                unreadable[recording.relative] = str(err).removeprefix(f"{recording.path}: ")
    if damaged:
        echo(
            f"Damaged: {names_text(damaged)}. Builds use those of which nothing is missing; `bagassets doctor` says what can be "
            "read of the others, and `recover: all` in bags of the recipe has that used."
        )
    proposal = propose_recipe(
        summaries,
        name=project.name,
        root=os.path.relpath(root, project) if root.is_relative_to(project) else root,
        include=bags.include if "include" in bags.model_fields_set else (),
        asked=discovery.asked,
        unreadable=unreadable,
        found=len(recordings),
        digest_attributes=digest_attributes,
        calibrations=find_calibrations(root, project, nested=not is_one),
        urdfs=True,
    )
    return proposal, unreadable
