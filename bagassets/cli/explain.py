"""`bagassets explain`: why an asset of a recording is in its state."""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import click

from bagassets.cli.options import recipe_option
from bagassets.cli.terminal import echo, echo_json, echo_lines
from bagassets.errors import RecipeError
from bagassets.escaping import visible

if TYPE_CHECKING:
    from bagassets.build.explain import ActionPair, Explanation
    from bagassets.defs.own_states import OwnState

__all__ = ["explain"]

_LONGEST = 60
_SHORT_DIGEST = 16


@click.command(
    epilog="""\b
Examples:
  bagassets explain monday.bag frames
  bagassets explain 'runs/tuesday' nuscenes_tables --json
  bagassets explain monday.bag sharpness        # an asset of your own that reads ours

\b
Exit status: 0 in any state; 1 if the recipe is wrong; 2 if there is no such recording or asset."""
)
@click.argument("bag")
@click.argument("asset")
@recipe_option
@click.option("--json", "as_json", is_flag=True, help="Print everything as JSON.")
def explain(bag: str, asset: str, recipe: Path, as_json: bool) -> None:
    """Show what an asset of a recording is made from, and what has changed since the last time.

    BAG is the key or path of a recording, ASSET one of its assets. The inputs, parameters and libraries of its action
    are printed beside those of the action that Dagster recorded last. ASSET may be one of your own, too: what it read
    last is printed beside what it would read now.
    """
    from bagassets.build.build_report import BuildOptions
    from bagassets.build.choose import SelectionError, choose_assets, choose_recordings
    from bagassets.build.explain import explain_asset
    from bagassets.build.planner import Planner
    from bagassets.defs.instance_plan import recorded_assets
    from bagassets.defs.own_build import load_own
    from bagassets.defs.pending_work import find_pending_work, open_project

    with open_project(recipe) as (instance, known_as):
        own = load_own(known_as)
        workspace = own.workspace
        if asset not in own.assets:  # one of the user's may be below our prefix, too
            asset = workspace.names.shorten(asset)
        recordings = workspace.discover().recordings
        planner = Planner(workspace.assets, workspace.store, workspace.index)
        known = ("bag", *planner.assets.names)
        if own.problem and asset not in known:
            raise RecipeError(own.problem)
        try:
            keys = sorted(choose_recordings(recordings, [bag]))
            choose_assets((*known, *own.assets), [asset])
        except SelectionError as err:
            raise click.UsageError(str(err)) from err
        if len(keys) > 1:
            raise click.UsageError(
                f"{bag}: matches {len(keys)} recordings ({', '.join(keys[:3])}, …); name one."
            )
        if asset in own.assets:
            pending = find_pending_work(instance, workspace)
            states = own.survey(instance, pending, BuildOptions()).states[asset]
            _print_own(asset, keys[0] if own.assets[asset].is_partitioned else "", states, as_json=as_json)
            return
        recorded = recorded_assets(instance, workspace.names, keys[0])
        explanation = explain_asset(planner, recordings[keys[0]], recorded, asset)
    if as_json:
        echo_json(explanation.as_json())
        return
    for line in explanation_lines(explanation):
        echo(line)


def _print_own(asset: str, key: str, states: "Mapping[str, OwnState]", *, as_json: bool) -> None:
    """Print why one of the user's own assets is in its state; `key` is empty for one that is made once."""
    one = states[key]
    if as_json:
        value = {"key": key or None, "asset": asset, **one.as_json(), "reads": dict(one.reads)}
        echo_json(value | {"recorded": None if one.recorded is None else dict(one.recorded)})
        return
    of_key = f" of {key}" if key else ""
    echo_lines(f"{asset}{of_key} {_predicate(one.state)}: {visible(one.reason)}")
    for name, now in one.reads.items():
        for line in _row(f"reads {name}", (one.recorded or {}).get(name) or None, now or None):
            echo_lines(line)


def _predicate(state: str) -> str:
    return "has failed" if state == "failed" else f"is {state}"


def explanation_lines(explanation: "Explanation") -> Iterator[str]:
    """Yield an explanation as lines of text."""
    # Reasons may hold parentheses.
    state = explanation.state
    yield f"{explanation.asset} of {explanation.key} {_predicate(state.state)}: {state.reason}"
    last = explanation.recorded
    yield from _row("data version", last and last.data_version, explanation.state.data_version)
    if explanation.code_version is not None:
        yield from _row("code version", last and last.code_version, explanation.code_version)
    if last is not None:
        yield f"  recorded by run {last.run_id or '(none)'}"
    for pair in explanation.actions:
        yield from _action_lines(pair)
    if explanation.asset != "bag" and not explanation.actions:
        yield "  Its action is not known: an input is not known yet, or the recording is skipped."


def _action_lines(pair: "ActionPair") -> Iterator[str]:
    from bagassets.build.differences import flatten

    value = pair.as_json()
    # If one of them is not known, there is nothing to compare, and the other is printed alone.
    last, now = value["last"] or value["now"] or {}, value["now"] or value["last"] or {}
    of = f" of {pair.channel}" if pair.channel else ""
    remark = "" if pair.now is not None else " (the last one; the current one is not known yet)"
    remark = remark if pair.last is not None else " (there was none before)"
    yield f"action{of}: {now.get('step')}{remark}"
    yield from _row("digest", last.get("digest"), now.get("digest"))
    yield from _row("version", last.get("version"), now.get("version"))
    for group, name_of in (("libraries", "library"), ("params", "param"), ("inputs", "input")):
        before, after = dict(flatten(last.get(group, {}))), dict(flatten(now.get(group, {})))
        for name in sorted(before.keys() | after.keys()):
            yield from _row(f"{name_of} {name}", before.get(name), after.get(name))


def _row(name: str, last: object, now: object) -> Iterator[str]:
    """Yield one line; if the values differ, it shows both and is marked."""
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
