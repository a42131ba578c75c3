"""`bagassets status`: the state of every asset of every recording, and why."""

import sys
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from bagassets.base.alike import names_text, recordings_text, told_once
from bagassets.base.errors import SelectionError
from bagassets.base.escaping import visible
from bagassets.base.json_types import JsonMapping, JsonObject
from bagassets.base.quantities import count_text
from bagassets.cli.exit_status import ExitStatus
from bagassets.cli.options import recipe_option
from bagassets.cli.terminal import echo_json, echo_lines, print_lines

if TYPE_CHECKING:
    from rich.table import Table

    from bagassets.defs.builds.own_states import OwnProject
    from bagassets.defs.builds.pending_work import PendingWork
    from bagassets.engine.plan import AssetState


# Beyond this number, fresh recordings are not listed, and others in the same states share a row.
MOST_ROWS = 40
# Narrower terminals get shorter column headings.
_WIDE = 110
_Row = tuple[str, Mapping[str, str]]
_ORDER = ("fresh", "record-only", "stale", "unknown", "missing", "failed", "skipped")
_COLOURS = {"fresh": "green", "record-only": "cyan", "stale": "yellow", "unknown": "yellow", "missing": "yellow",
            "failed": "bold red", "skipped": "dim"}  # fmt: skip


@click.command(
    epilog="""\b
Examples:
  bagassets status
  bagassets status --bag 'monday*' --all
  bagassets status --json | jq '.recordings[].assets.frames.state'

\b
States:
  fresh        nothing to do
  record-only  the result is in the store, but Dagster's record is older: recorded again, nothing runs
  stale        inputs, recipe fields or versions changed: will run
  unknown      depends on a result that is not known yet: may run
  missing      never made: will run
  failed       failed on its current input; retried when that changes, or with build --retry-failed
  skipped      the recording is not part of the dataset

\b
Exit status: 0 everything is fresh or skipped; 1 something failed and there is nothing else to do;
3 there is something to do."""
)
@recipe_option
@click.option("--bag", "bags", multiple=True, metavar="BAG",
              help="Only this recording: its key, a glob of keys, or its path; may be repeated.")  # fmt: skip
@click.option("--all", "show_all", is_flag=True, help="List fresh recordings, too, however many there are.")
@click.option("--json", "as_json", is_flag=True, help="Print all states and reasons as JSON.")
def status(recipe: Path, bags: tuple[str, ...], show_all: bool, as_json: bool) -> None:
    """Show what is fresh, stale, skipped or failed, and why.

    Every asset of every recording has a state, with the reason, traced back to the first change. Nothing is run and no
    recording is read: changes are found by sizes, times and stored digests.
    """
    from bagassets.cli.progress import planning_shown
    from bagassets.defs.builds.own_states import load_own
    from bagassets.defs.builds.pending_work import find_pending_work, open_project
    from bagassets.engine.build_report import BuildOptions
    from bagassets.formats.catalogue import problems_of
    from bagassets.formats.emptiness import left_behind

    try:
        with planning_shown() as on_planned, open_project(recipe) as known_as:
            project = load_own(known_as)
            workspace = project.workspace
            pending = find_pending_work(workspace, BuildOptions(bags=bags), on_planned=on_planned)
            own = project.survey(pending)
    except SelectionError as err:
        raise click.UsageError(str(err)) from err
    problems = [*problems_of(workspace.recipe), *left_behind(workspace.recipe).values()]
    if as_json:
        echo_json(_status_json(pending, own, problems))
    else:
        _print(pending, own, show_all=show_all or bool(bags))
        for problem in problems:
            echo_lines(f"warning: {problem}", err=True)
    if not (pending.is_settled and own.is_settled):
        sys.exit(ExitStatus.FOUND)
    if pending.failed or own.failed:
        sys.exit(ExitStatus.FAILED)


def _status_json(pending: "PendingWork", own: "OwnProject", problems: Sequence[str] = ()) -> JsonObject:
    """Return all states as JSON, and the problems of installed packages, and of datasets that nothing asks for any more."""
    bags = {key: bag for key, bag in pending.plan.bags.items() if key in pending.asked.chosen}
    return {
        "settled": pending.is_settled and own.is_settled,
        "recordings": {
            key: {"format": bag.format, "registered": key in pending.plan.live, "assets": bag.as_json()}
            for key, bag in bags.items()
        },
        **own.as_json(),
        "removed": list(pending.plan.removed),
        "excluded": dict(pending.plan.excluded),
        **({"asked": dict(pending.plan.asked)} if pending.plan.asked else {}),
        **({"problems": list(problems)} if problems else {}),
    }


def _print(pending: "PendingWork", own: "OwnProject", *, show_all: bool) -> None:
    from bagassets.cli.summary import summary_console

    console = summary_console()
    listed = bags = {key: bag for key, bag in pending.plan.bags.items() if key in pending.asked.chosen}
    if len(bags) > MOST_ROWS and not show_all:
        listed = {key: bag for key, bag in bags.items() if not bag.settled}
    if listed:
        rows: list[_Row] = [(key, {n: s.state for n, s in bag.assets.items()}) for key, bag in listed.items()]
        if len(rows) > MOST_ROWS and not show_all:
            rows = _alike(rows)
        console.print(_table(rows, short=console.width < _WIDE), crop=False)  # narrow terminals wrap it
    if number := len(bags) - len(listed):
        console.print(f"{number} more {'is' if number == 1 else 'are'} fresh or skipped; --all lists all.")
    for line in _reasons(pending, listed):
        print_lines(console, line)
    for line in _target_lines(own):
        print_lines(console, line)
    counts = Counter[str](state.state for bag in bags.values() for state in bag.assets.values())
    counted = ", ".join(f"{counts[state]} {state}" for state in _ORDER if counts[state])
    console.print(f"assets of {count_text(len(bags), 'recording')}: {counted or 'none'}.")


def _target_lines(own: "OwnProject") -> Iterator[str]:
    """Yield the state of each dataset and of each of the user's own assets, or how many recordings are in which, and why."""
    found = []
    for name, states in own.targets.items():
        if states.keys() == {""}:
            one = states[""]
            yield f"{name} {one.state}: {visible(one.reason)}" if one.state != "fresh" else f"{name}: fresh"
            continue
        counts = Counter(one.state for one in states.values())
        yield f"{name}: {', '.join(f'{counts[state]} {state}' for state in counts) or 'no recordings'}"
        to_tell = {key: one for key, one in states.items() if one.state not in {"fresh", "skipped"}}
        found += [((name, one.state), key, one.reason) for key, one in to_tell.items()]
    for told in told_once(found):
        yield f"{told.title}: {' '.join(told.kind)}: {visible(told.text)}"
    for name, why in own.left_out.items():
        yield f"{name}: not made by a build ({why})"
    if own.problem:
        yield f"error: {visible(own.problem)}"


def _alike(rows: Iterable[_Row]) -> list[_Row]:
    """Return one row for all recordings whose assets are in the same states."""
    found: dict[tuple[str, ...], tuple[list[str], Mapping[str, str]]] = {}
    for key, states in rows:
        found.setdefault(tuple(states.values()), ([], states))[0].append(key)
    return [(recordings_text(keys), states) for keys, states in found.values()]


def _table(rows: Sequence[_Row], *, short: bool) -> "Table":
    from rich import box
    from rich.table import Table
    from rich.text import Text

    from bagassets.formats.catalogue import known_assets

    headings = {asset.name: asset.face.heading for asset in known_assets()}
    assets = list(rows[0][1])
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=0)
    table.add_column("recording", overflow="fold", min_width=9)
    for name in assets:
        heading = (headings.get(name) or name.rpartition("_")[2]) if short else name.replace("_", " ")
        table.add_column(heading, overflow="fold", min_width=max(len(row[name]) for _, row in rows))
    for key, row in rows:
        table.add_row(key, *(Text(row[name], style=_COLOURS[row[name]]) for name in assets))
    return table


def names_by_reason(assets: Mapping[str, "AssetState"]) -> dict[tuple[str, str], list[str]]:
    """Return state and reason -> the assets of a recording that are not fresh; a cause that another states is not repeated."""
    by_reason: dict[tuple[str, str], list[str]] = {}
    above = {state.reason for state in assets.values()}
    for name, state in assets.items():
        if state.state != "fresh":
            waits, _, why = state.reason.partition(" — ")
            by_reason.setdefault((state.state, waits if why in above else state.reason), []).append(name)
    return by_reason


def _reasons(pending: "PendingWork", listed: JsonMapping) -> Iterator[str]:
    """Yield the reasons of everything that is not fresh; assets, and recordings, with the same reason share a line."""
    found = []
    for key, bag in listed.items():
        for (state, reason), names in names_by_reason(bag.assets).items():
            shown = "all but bag and inventory" if state == "skipped" else ", ".join(names)
            found.append(((shown, state), key, reason))
    for told in told_once(found):
        shown, state = told.kind
        yield f"{told.title}: {shown} {state}: {told.text if state == 'failed' else visible(told.text)}"
    for whole, keys in pending.plan.joined.items():
        yield f"{names_text(keys)}: parts of {whole}, into which the next build joins them"
    all_gone = "" if pending.plan.bags else ", with --allow-empty,"
    for key in pending.plan.gone:
        then = pending.held.get(key, f"the next build{all_gone} removes its partition and its scenes")
        yield f"{key}: the recording is gone; {then}"
    excluded = (((), *one) for one in pending.plan.excluded.items() if not one[1].startswith("not matched"))
    for told in told_once(excluded):
        yield f"{visible(told.title)}: left out: {visible(told.text)}"
    for question in pending.plan.asked.values():
        yield f"to be decided: {visible(question)}"
