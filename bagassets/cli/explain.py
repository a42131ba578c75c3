"""`bagassets explain`: why one asset of one recording is in its state."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from bagassets.cli.options import recipe_option
from bagassets.cli.terminal import echo, echo_lines

if TYPE_CHECKING:
    from bagassets.build.explain import ActionPair, Explanation

__all__ = ["explain"]

_LONGEST = 60
_SHORT_DIGEST = 16


@click.command(
    epilog="""\b
Examples:
  bagassets explain monday.bag frames
  bagassets explain 'runs/tuesday' nuscenes_tables --json

\b
Exit status: 0, whatever the state; 1 if the recipe is wrong, 2 if there is no such recording or asset."""
)
@click.argument("bag")
@click.argument("asset")
@recipe_option
@click.option("--json", "as_json", is_flag=True, help="Print everything as JSON.")
def explain(bag: str, asset: str, recipe: Path, as_json: bool) -> None:
    """Tell what an asset of a recording is made from, and what differs from the last time.

    BAG is a recording's key or path, ASSET one of its assets. Inputs, parameters and libraries of the
    action are printed beside those of the action that Dagster recorded last.
    """
    from bagassets.build.choose import SelectionError, choose_assets, choose_recordings
    from bagassets.build.explain import explain_asset
    from bagassets.build.planner import Planner
    from bagassets.defs.instance_plan import recorded_assets
    from bagassets.defs.pending_work import open_project

    with open_project(recipe) as (instance, workspace):
        recordings = workspace.discover().recordings
        planner = Planner(workspace.assets, workspace.store, workspace.index)
        try:
            keys = sorted(choose_recordings(recordings, [bag]))
            choose_assets(("bag", *planner.assets.names), [asset])
        except SelectionError as err:
            raise click.UsageError(str(err)) from err
        if len(keys) > 1:
            raise click.UsageError(
                f"{bag}: means {len(keys)} recordings ({', '.join(keys[:3])}, …); name one."
            )
        recorded = recorded_assets(instance, workspace.recipe, keys[0])
        explanation = explain_asset(planner, recordings[keys[0]], recorded, asset)
    if as_json:
        echo_lines(json.dumps(explanation.as_json(), indent=1))
        return
    for line in explanation_lines(explanation):
        echo(line)


def explanation_lines(told: "Explanation") -> Iterator[str]:
    """Yield an explanation for people."""
    yield f"{told.asset} of {told.key}: {told.state.state} ({told.state.reason})"
    last = told.recorded
    yield from _row("data version", last and last.data_version, told.state.data_version)
    if told.code_version is not None:
        yield from _row("code version", last and last.code_version, told.code_version)
    if last is not None:
        yield f"  recorded by run {last.run_id or '(none)'}"
    for pair in told.actions:
        yield from _action_lines(pair)
    if told.asset != "bag" and not told.actions:
        yield "  Its action is not known: what it reads is not known yet, or the recording takes no part."


def _action_lines(pair: "ActionPair") -> Iterator[str]:
    from bagassets.build.differences import flatten

    value = pair.as_json()
    # Where one of them is not known there is nothing to compare: it is printed as it is.
    last, now = value["last"] or value["now"] or {}, value["now"] or value["last"] or {}
    of = f" of {pair.channel}" if pair.channel else ""
    remark = "" if pair.now is not None else " (the last one; what it would be now is not known yet)"
    remark = remark if pair.last is not None else " (there was none before)"
    yield f"action{of}: {now.get('step')}{remark}"
    yield from _row("digest", last.get("digest"), now.get("digest"))
    yield from _row("version", last.get("version"), now.get("version"))
    for group, name_of in (("libraries", "library"), ("params", "param"), ("inputs", "input")):
        before, after = dict(flatten(last.get(group, {}))), dict(flatten(now.get(group, {})))
        for name in sorted(before.keys() | after.keys()):
            yield from _row(f"{name_of} {name}", before.get(name), after.get(name))


def _row(name: str, last: object, now: object) -> Iterator[str]:
    """Yield one line; where both differ it is marked and has both."""
    if last == now:
        yield f"    {name}: {_value(now)}"
    else:
        yield f"  * {name}: {_value(last)} -> {_value(now)}"


def _value(value: object) -> str:
    if value is None:
        return "-"
    text = value if isinstance(value, str) else json.dumps(value, sort_keys=True)
    if len(text) == 64 and set(text) <= set("0123456789abcdef"):
        return text[:_SHORT_DIGEST]
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}…"
