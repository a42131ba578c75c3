"""`bagassets convert`: the dataset of one recording, without a project."""

import os
import signal
from pathlib import Path
from typing import TYPE_CHECKING

import click

from bagassets.base.errors import DatasetError, RecipeError, RecordingError
from bagassets.base.quantities import count_text
from bagassets.cli.exit_status import ExitStatus
from bagassets.cli.terminal import echo, echo_lines, quoted

if TYPE_CHECKING:
    from bagassets.engine.build_report import BuildReport, SummaryRow
    from bagassets.formats.format import AnyFormat
    from bagassets.propose.proposal import Proposal
    from bagassets.recipe.model import Bags, Recipe


@click.command(
    epilog="""\b
Examples:
  bagassets convert monday.bag monday
  bagassets convert monday.mcap sequences --format vision
  bagassets convert monday_0.bag monday_1.bag monday                   # the parts of one drive
  bagassets convert monday.bag monday --recipe monday.recipe.yaml      # once its questions are answered
  bagassets convert tuesday.bag tuesday --recipe monday/recipe.yaml    # of the same robot

\b
Exit status:
    0  OUT is there
    1  the recording cannot be converted, or OUT, the recipe or the disk is wrong
    2  wrong usage, or something is to be decided first
  130  interrupted"""
)
@click.argument("bags_", metavar="BAG...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.argument("out", type=click.Path(path_type=Path))
@click.option("--recipe", "recipe_file", type=click.Path(dir_okay=False, path_type=Path), metavar="FILE",
              help="Convert with this recipe; which recordings it takes, its folders and other datasets are ignored. "
              "Default: guess one.")  # fmt: skip
@click.option("--format", "format_name", metavar="NAME",
              help="Format of the dataset; `bagassets formats` lists them. Default: the first of the recipe, "
              "which is nuscenes or, of an arm, lerobot.")  # fmt: skip
def convert(bags_: tuple[Path, ...], out: Path, recipe_file: Path | None, format_name: str | None) -> int:
    """Convert one recording into a dataset, without a project.

    A recipe is guessed from the first seconds of BAG, as `bagassets init` does. OUT, a folder that must
    not exist, gets the dataset and, as OUT/recipe.yaml, the recipe; it appears when it is complete. BAG is only
    read. Several files are the parts of one drive. For more than one recording, or to build again after a change, make a project: `bagassets init`.

    What cannot be guessed is listed. The recipe is then written to OUT.recipe.yaml: decide there, and convert
    again with --recipe.
    """
    from bagassets.recipe.format_settings import DEFAULT_FORMAT, OUR_FORMATS
    from bagassets.recipe.load import parse_recipe
    from bagassets.recordings.discover import bags_of_one, bags_of_parts, series_with
    from bagassets.recordings.series import candidates, odd_number

    out = out.absolute()
    if os.path.lexists(out):
        raise DatasetError(f"{out} exists already; name another folder, or move this one away.")
    kind = None if format_name is None else _format(format_name)
    files = list(dict.fromkeys(bag.resolve() for bag in bags_))
    bags = bags_of_one(files[0]) if len(files) == 1 else bags_of_parts(files)
    if len(files) == 1 and (whole := series_with(files[0])):
        echo(f"{files[0].name} is part of {whole}; for the whole drive, name all its parts.", err=True)
    for one in candidates(map(str, files)):
        if odd := odd_number(one.numbers.values()):
            echo(f"warning: {one.whole}: {odd}; the drive is converted as it is.", err=True)
    if recipe_file is not None:
        recipe, text, kind = _read(recipe_file, kind)
        return _build(_matched(recipe, bags), bags, kind, out, text)
    proposal = _propose(bags)
    proposed = [name for name in OUR_FORMATS if f"\n{name}:" in proposal.text] or [DEFAULT_FORMAT]
    kind = kind or _format(proposed[0])
    text = proposal.text + ("" if kind.name in proposed else _section(kind))
    beside = out.with_name(f"{out.name}.recipe.yaml")
    problems: list[str] = []
    if not proposal.questions:
        try:
            recipe = parse_recipe(text, beside)
        except RecipeError as err:
            problems = str(err).splitlines()
    if proposal.questions or problems:
        from bagassets.cli.init_report import print_questions

        _write_beside(beside, text)
        command = f"bagassets convert {' '.join(map(quoted, (*bags_, out)))} --recipe {quoted(beside)}"
        command += f" --format {kind.name}" if format_name else ""
        print_questions(f"{beside}, the guessed recipe", proposal, problems, command)
        return ExitStatus.UNDECIDED
    status = _build(recipe, bags, kind, out, text)
    if status == ExitStatus.FAILED:
        _write_beside(beside, text)
        echo(
            f"The guessed recipe is in {beside}; if it is to blame, correct it and add --recipe {quoted(beside)}.",
            err=True,
        )
    if status == 0 and proposal.guesses:
        plural = "guess is" if proposal.guesses == 1 else "guesses are"
        echo(f"{proposal.guesses} {plural} marked in {quoted(out / 'recipe.yaml')}.")
    return status


# --- the recipe --------------------------------------------------------------------------


def _format(name: str) -> "AnyFormat":
    from bagassets.formats.catalogue import formats, installed_format

    kind = installed_format(name)
    if kind is None:
        known = ", ".join(kind.name for kind in formats())
        raise click.BadParameter(
            f"there is no format {name}; the formats are {known}.", param_hint="--format"
        )
    return kind


def _propose(bags: "Bags") -> "Proposal":
    """Guess a recipe for a recording, and print what it holds.

    Raises:
        RecordingError: it cannot be read, or holds nothing that any recipe could convert.
    """
    from bagassets.cli.init_report import print_found
    from bagassets.propose.calibration_files import find_calibrations
    from bagassets.propose.proposal import propose_recipe
    from bagassets.propose.scan import scan_recording
    from bagassets.recordings.discover import discover
    from bagassets.recordings.salvage.open import read_as_far

    (recording,) = discover(bags).recordings.values()
    summary = read_as_far(recording, scan_recording)
    proposal = propose_recipe(
        {recording.relative: summary},
        name=recording.path.stem,
        root=bags.root,
        include=bags.include if "include" in bags.model_fields_set else (),
        series=bags.series,
        calibrations=find_calibrations(bags.root, None, nested=False),
    )
    print_found(proposal, {})
    uses = [use for bare in proposal.bare for use in bare.topic_uses]
    if not proposal.rigs and not any(use.status == "not decodable" for use in uses):
        raise RecordingError(f"{recording.path}: nothing to convert: it has no camera, lidar or radar.")
    return proposal


def _section(kind: "AnyFormat") -> str:
    """Return the lines of a recipe that ask for a dataset with the defaults of its format."""
    if kind.distribution:
        return f"formats:\n  {kind.name}: {{output: dataset/{kind.name}}}\n"
    return f"{kind.name}: {{}}\n"


def _read(path: Path, kind: "AnyFormat | None") -> "tuple[Recipe, str, AnyFormat]":
    """Return the recipe of a user, its text, with a comment that says where it is from, and the format: its first one if none is given."""
    from bagassets.recipe import load_recipe
    from bagassets.recipe.format_settings import DEFAULT_FORMAT

    recipe = load_recipe(path)
    kind = kind or _format(next(iter(recipe.dataset_settings), DEFAULT_FORMAT))
    if kind.name not in recipe.dataset_settings:
        lines = _section(kind).splitlines()
        raise RecipeError(
            f"{path}: this recipe asks for no {kind.name} dataset; add `{' '.join(line.strip() for line in lines)}`."
        )
    path = path.absolute()
    origin = f"# Copied by `bagassets convert` from {path}; relative paths are from {path.parent}.\n"
    text = path.read_text(encoding="utf-8")
    return recipe, text if text.startswith("# Copied by `bagassets convert`") else origin + text, kind


def _matched(recipe: "Recipe", bags: "Bags") -> "Recipe":
    """Return a recipe with a rig for the recording: its only one, whatever that matches, or the one that matches.

    Raises:
        RecipeError: several rigs, of which none matches, or one for which something is to be decided.
    """
    from bagassets.assets.selection import choose_rig
    from bagassets.recordings.discover import discover

    (recording,) = discover(bags).recordings.values()
    paths = [recording.path, *(part.path for part in recording.parts)]
    inside = [path for path in paths if path.is_relative_to(recipe.bags.root)]
    names = [*recording.names, *(path.relative_to(recipe.bags.root).as_posix() for path in inside)]
    rig = recipe.rigs[0] if len(recipe.rigs) == 1 else choose_rig(recipe, *names)
    if rig is None:
        rigs = ", ".join(rig.name for rig in recipe.rigs)
        raise RecipeError(
            f"{recording.path}: none of the rigs {rigs} matches this recording; leave only its rig in the recipe."
        )
    if rig.questions:
        raise RecipeError(*rig.questions)
    return recipe.model_copy(update={"rigs": (rig.model_copy(update={"match": ("**",)}),)})


def _write_beside(path: Path, text: str) -> None:
    """Write the guessed recipe for its user, who may have edited the one that is there.

    Raises:
        RecipeError: another one is there, or it cannot be written.
    """
    try:
        if path.exists() and path.read_text(encoding="utf-8") == text:
            return
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        raise RecipeError(
            f"{path} exists already; convert with --recipe {quoted(path)} if you edited it, or remove it."
        ) from None
    except OSError as err:
        raise RecipeError(f"{path}: the recipe cannot be written ({err.strerror or err}).") from err


# --- the build ---------------------------------------------------------------------------


def _build(recipe: "Recipe", bags: "Bags", kind: "AnyFormat", out: Path, text: str) -> int:
    """Build the dataset, move it to `out`, and return the exit status."""
    from bagassets.base.interrupts import signals_handled
    from bagassets.cli.build import build_with_progress
    from bagassets.cli.remote import InterruptedBuildError
    from bagassets.cli.summary import print_remarks, summary_console
    from bagassets.cli.throw_away import throw_away_project
    from bagassets.engine.build_report import BuildOptions, BuildReport, SummaryRow
    from bagassets.formats.dataset_lock import read_lock

    options = BuildOptions(jobs=1, select=(kind.asset,))
    # SIGTERM and SIGHUP end the command as Ctrl-C does, so that nothing is left behind.
    interrupted = signals_handled(signal.default_int_handler, signal.SIGTERM, signal.SIGHUP)
    try:
        with interrupted, throw_away_project(recipe, bags, kind, out) as project:
            result = build_with_progress(project.recipe_file, options, None, None)
            report = BuildReport.from_json(result)
            rows = [SummaryRow.from_json(row) for row in result["summary"]]
            if report.interrupted:
                raise click.Abort
            print_remarks(report.remarks, summary_console())
            problem = _problem(report, rows)
            counts: dict[str, int] = {}
            if problem is None:
                lock = read_lock(project.dataset / kind.folder(recipe.dataset_settings[kind.name]))
                for entry in () if lock is None else lock.value["bags"]:
                    counts |= entry["counts"]
                if not any(counts.values()):
                    said = any(one.severity == "error" for one in report.remarks)
                    why = ", as the error above says." if said else "; it may be too short, see the recipe."
                    problem = f"{rows[0].recording}: its dataset would be empty{why}"
            if problem is not None:
                echo_lines(f"error: {problem}", err=True)
                return ExitStatus.FAILED
            (project.dataset / "recipe.yaml").write_text(text, encoding="utf-8")
            project.move_dataset(out)
    except (InterruptedBuildError, KeyboardInterrupt) as err:
        raise click.Abort from err
    counts |= {
        name: rows[0].counts.get(name) or 0 for name in ("images", "sweeps", "boxes") if name not in counts
    }
    given = ", ".join(count_text(number, name.removesuffix("s")) for name, number in counts.items() if number)
    echo(f"{quoted(out)}: {given}")
    return 0


def _problem(report: "BuildReport", rows: "list[SummaryRow]") -> str | None:
    """Return why there is no dataset worth moving, or None."""
    for row in rows:
        if row.result not in {"built", "hit", "fresh"}:
            return f"{row.recording}: {row.reason}"
        if row.counts.get("scenes") == 0:
            return f"{row.recording}: it has no scene, so the dataset would be empty."
    if report.dataset == "failed":  # of one that is empty, it names a recipe that will be gone
        return report.dataset_problem
    return None if rows else "the recording is gone."
