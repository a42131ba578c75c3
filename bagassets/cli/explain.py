"""`bagassets explain`: why an asset of a recording is in its state."""

import json
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import click

from bagassets.base.alike import names_text, told_once
from bagassets.base.errors import RecipeError
from bagassets.base.escaping import visible
from bagassets.base.quantities import count_text
from bagassets.cli.options import recipe_option
from bagassets.cli.terminal import echo, echo_json, echo_lines

if TYPE_CHECKING:
    from bagassets.defs.builds.own_states import OwnState
    from bagassets.defs.builds.pending_work import PendingWork
    from bagassets.engine.explain import ActionPair, Explanation
    from bagassets.engine.plan import Recorded
    from bagassets.recipe.model import Recipe

__all__ = ["explain"]

_LONGEST = 60
_SHORT_DIGEST = 16


@click.command(
    epilog="""\b
Examples:
  bagassets explain monday.bag frames
  bagassets explain 'runs/tuesday' nuscenes_tables --json
  bagassets explain nuscenes_dataset            # which recordings it has, and what would change
  bagassets explain monday.bag nuscenes_dataset # what it has of one
  bagassets explain monday.bag sharpness        # an asset of your own that reads ours

\b
Exit status: 0 in any state; 1 if the recipe is wrong; 2 if there is no such recording or asset."""
)
@click.argument("bag", required=False, metavar="[BAG]")
@click.argument("asset", required=False, metavar="ASSET")
@recipe_option
@click.option("--json", "as_json", is_flag=True, help="Print everything as JSON.")
def explain(bag: str | None, asset: str | None, recipe: Path, as_json: bool) -> None:
    """Show what an asset of a recording is made from, and what has changed since the last time.

    BAG is the key or path of a recording, ASSET one of its assets. The inputs, parameters and libraries of its action
    are printed beside those of the action that Dagster recorded last. ASSET may be one of your own, too: what it read
    last is printed beside what it would read now. For a dataset, BAG may be left out.
    """
    from bagassets.defs.builds.own_build import load_own
    from bagassets.defs.builds.pending_work import find_pending_work, open_project
    from bagassets.defs.records.events import recorded_whole
    from bagassets.defs.records.instance_plan import recorded_assets
    from bagassets.engine.build_report import BuildOptions
    from bagassets.engine.choose import SelectionError, choose_assets, choose_recordings
    from bagassets.engine.explain import explain_asset
    from bagassets.engine.planner import Planner
    from bagassets.formats.dataset_build import dataset_code_versions

    wanted, asset = ([bag], asset) if bag and asset else ([], bag or "")
    with open_project(recipe) as (instance, known_as):
        own = load_own(known_as)
        workspace = own.workspace
        if asset not in own.assets:  # one of the user's may be below our prefix, too
            asset = workspace.names.shorten(asset)
        recordings = workspace.discover().recordings
        planner = Planner(workspace.assets, workspace.store, workspace.index)
        datasets = dataset_code_versions(workspace.recipe)
        known = ("bag", *planner.assets.names, *datasets)
        if own.problem and asset not in known:
            raise RecipeError(own.problem)
        names, lacking = (*known, *own.assets), "" if asset else "name an asset"
        if asset and not wanted and asset not in names:
            with suppress(SelectionError):
                choose_recordings(recordings, [asset])
                lacking = f"{asset} is a recording; name one of its assets, too"
        if lacking:
            raise click.UsageError(f"{lacking}: {', '.join(names)}.")
        try:
            keys = sorted(choose_recordings(recordings, wanted))
            choose_assets(names, [asset])
        except SelectionError as err:
            raise click.UsageError(str(err)) from err
        if len(keys) > 1:
            raise click.UsageError(
                f"{bag}: matches {len(keys)} recordings ({', '.join(keys[:3])}, …); name one."
            )
        if asset in datasets:
            pending = find_pending_work(instance, workspace)
            record = recorded_whole(instance, workspace.names, asset)
            _explain_dataset(asset, keys, pending, workspace.recipe, record, as_json=as_json)
            return
        if not keys and (asset not in own.assets or own.assets[asset].is_partitioned):
            raise click.UsageError(
                f"{asset}: each recording has its own; name one: `bagassets explain BAG {asset}`."
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


def _explain_dataset(
    asset: str,
    keys: list[str],
    pending: "PendingWork",
    recipe: "Recipe",
    recorded: "Recorded | None",
    *,
    as_json: bool,
) -> None:
    """Print why a dataset is in its state, and what it has of all recordings, or of those named by `keys`."""
    from bagassets.engine.explain import SHOWN
    from bagassets.formats.dataset_build import dataset_code_versions, dataset_contents

    state, version = pending.dataset_states[asset], dataset_code_versions(recipe)[asset]
    contents = dataset_contents(recipe, pending.planned.inputs, asset)
    shown = keys or sorted(contents.now.keys() | (contents.last or {}).keys())
    last = contents.now if contents.last is None else contents.last
    rows = {key: (last.get(key), contents.now.get(key)) for key in shown}
    left_out = {key: why for key, why in contents.left_out.items() if not keys or key in keys}
    returned = [key for key in contents.returned if not keys or key in keys]
    if as_json:
        echo_json(
            {
                "asset": asset,
                "state": state.state,
                "reason": state.reason,
                "code_version": version,
                "recorded": recorded and {name: getattr(recorded, name) for name in SHOWN},
                "made_from": contents.part,
                "recordings": {key: {"last": was, "now": now} for key, (was, now) in rows.items()},
                "left_out": left_out,
                "no_longer_left_out": returned,
            }
        )
        return
    echo(_head(asset, "", state.state, state.reason))
    for line in _record_lines(recorded, None if recorded is None else recorded.data_version, version):
        echo(line)
    same = 0 if keys or contents.last is None else sum(was == now for was, now in rows.values())
    echo(
        f"made from {contents.part} of {count_text(len(contents.now), 'recording')}{f', {same} as before' if same else ''}"
    )
    for key, (was, now) in rows.items():
        if (keys and (was or now)) or was != now:
            echo(_row(key, was, now))
    for told in told_once(((), key, why) for key, why in left_out.items()):
        echo(f"left out: {told.title} ({told.text})")
    if returned:
        echo(f"no longer left out: {names_text(returned)}")


def _print_own(asset: str, key: str, states: "Mapping[str, OwnState]", *, as_json: bool) -> None:
    """Print why one of the user's own assets is in its state; `key` is empty for one that is made once."""
    one = states[key]
    if as_json:
        value = {"key": key or None, "asset": asset, **one.as_json(), "reads": dict(one.reads)}
        echo_json(value | {"recorded": None if one.recorded is None else dict(one.recorded)})
        return
    echo_lines(_head(asset, key, one.state, visible(one.reason)))
    for name, now in one.reads.items():
        echo_lines(_row(f"reads {name}", (one.recorded or {}).get(name) or None, now or None))


def _head(asset: str, key: str, state: str, reason: str) -> str:
    of_key = f" of {key}" if key else ""
    why = "" if state == "fresh" else f": {reason}"  # which may hold parentheses
    return f"{asset}{of_key} {'has failed' if state == 'failed' else f'is {state}'}{why}"


def _record_lines(
    last: "Recorded | None", data_version: str | None, code_version: str | None
) -> Iterator[str]:
    """Yield what is recorded of an asset, beside what would be recorded now, as far as that is known."""
    before = last and last.data_version
    yield _row("data version", before, data_version, unknown="not known yet")
    yield _row("code version", last and last.code_version, code_version)
    if last is not None:
        yield f"  recorded by run {last.run_id}" if last.run_id else "  recorded without a run"


def explanation_lines(explanation: "Explanation") -> Iterator[str]:
    """Yield an explanation as lines of text."""
    state, last = explanation.state, explanation.recorded
    yield _head(explanation.asset, explanation.key, state.state, state.reason)
    of_bag = None if last is None else last.code_version  # never another
    version = explanation.code_version if explanation.asset != "bag" else of_bag
    yield from _record_lines(last, state.data_version, version)
    for pair in explanation.actions:
        yield from _action_lines(pair)
    if explanation.asset != "bag" and not explanation.actions:
        yield "  Its action is not known: an input is not known yet, or the recording is skipped."


def _action_lines(pair: "ActionPair") -> Iterator[str]:
    from bagassets.engine.differences import flatten

    value = pair.as_json()
    # If one of them is not known, there is nothing to compare, and the other is printed alone.
    last, now = value["last"] or value["now"] or {}, value["now"] or value["last"] or {}
    of = f" of {pair.channel}" if pair.channel else ""
    remark = "" if pair.now is not None else ", as it was last; the current one is not known yet"
    remark = remark if pair.last is not None else ", the first one"
    yield f"action {now.get('step')}{of}{remark}"
    yield _row("digest", last.get("digest"), now.get("digest"))
    yield _row("version", last.get("version"), now.get("version"))
    for group, name_of in (("libraries", "library"), ("params", "param"), ("inputs", "input")):
        before, after = dict(flatten(last.get(group, {}))), dict(flatten(now.get(group, {})))
        for name in sorted(before.keys() | after.keys()):
            yield _row(f"{name_of} {name}", before.get(name), after.get(name))


def _row(name: str, last: object, now: object, unknown: str = "none") -> str:
    """Return one line; if the values differ, it shows both and is marked; `unknown` stands for one that is None."""
    if last == now:
        return f"    {name}: {_value(now, unknown)}"
    if last is None:
        return f"  * {name}: {_value(now)} (new)"
    return f"  * {name}: {_value(last)} -> {_value(now, unknown)}"


def _value(value: object, unknown: str = "none") -> str:
    if value is None:
        return unknown
    text = value if isinstance(value, str) else json.dumps(value, sort_keys=True)
    if len(text) == 64 and set(text) <= set("0123456789abcdef"):
        return text[:_SHORT_DIGEST]
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}…"
