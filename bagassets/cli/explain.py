"""`bagassets explain`: why an asset of a recording is in its state."""

import json
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import click

from bagassets.base.alike import names_text, recordings_text, told_once
from bagassets.base.errors import RecipeError, SelectionError
from bagassets.base.json_types import JsonMapping, JsonObject
from bagassets.base.quantities import count_text
from bagassets.cli.options import recipe_option
from bagassets.cli.terminal import echo, echo_json

if TYPE_CHECKING:
    from bagassets.engine.plan import AssetState
    from bagassets.engine.targets import Evidence, Target
    from bagassets.formats.dataset_build import DatasetContents

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
    from bagassets.defs.builds.own_states import load_own
    from bagassets.defs.builds.pending_work import find_pending_work, open_project
    from bagassets.engine.choose import choose_assets, choose_recordings
    from bagassets.engine.explain import explain_asset, explanation
    from bagassets.engine.planner import recorded_graph
    from bagassets.formats.dataset_build import dataset_code_versions, dataset_contents

    wanted, asset = ([bag], asset) if bag and asset else ([], bag or "")
    with open_project(recipe) as known_as:
        own = load_own(known_as)
        workspace = own.workspace
        if asset not in own.assets:  # one of the user's may be below our prefix, too
            asset = workspace.names.shorten(asset)
        recordings = workspace.discover().recordings
        datasets = dataset_code_versions(workspace.recipe)
        known = ("bag", *workspace.assets.names, *datasets)
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
            raise click.UsageError(f"{bag}: matches {recordings_text(keys)}; name one.")
        if not keys and asset not in datasets and (asset in known or own.assets[asset].is_partitioned):
            raise click.UsageError(
                f"{asset}: each recording has its own; name one: `bagassets explain BAG {asset}`."
            )
        if asset in datasets:
            pending = find_pending_work(workspace)
            state, recorded = pending.states[asset], workspace.records.whole(asset)
            contents = dataset_contents(workspace.recipe, pending.inputs, asset)
            why = explanation(asset, state, recorded, datasets[asset])
            value, lines = _of_dataset(why, contents, keys)
        elif asset in own.assets:
            own = own.survey(find_pending_work(workspace))
            key = keys[0] if own.assets[asset].is_partitioned else ""
            value, lines = _of_own(own.assets[asset], key, own.states[asset][key], own.evidence[asset][key])
        else:
            recorded_of_key = workspace.records.of_recording(keys[0])
            graph = recorded_graph(workspace.assets, recordings[keys[0]], recorded_of_key)
            value = explain_asset(graph, asset)
            lines = [*_lines(value)]
    if as_json:
        echo_json(value)
        return
    for line in lines:
        echo(line)


def _of_dataset(
    why: JsonObject, contents: "DatasetContents", keys: list[str]
) -> tuple[JsonObject, list[str]]:
    """Return, as JSON and as lines, why a dataset is in its state, and what it has of all recordings, or of those in `keys`."""
    last = contents.now if contents.last is None else contents.last
    rows = {key: (last.get(key), contents.now.get(key)) for key in keys or sorted(contents.now.keys() | last)}
    left_out = {key: why for key, why in contents.left_out.items() if not keys or key in keys}
    returned = [key for key in contents.returned if not keys or key in keys]
    value = {
        **why,
        "made_from": contents.part,
        "recordings": {key: {"last": was, "now": now} for key, (was, now) in rows.items()},
        "left_out": left_out,
        "no_longer_left_out": returned,
    }
    same = 0 if keys or contents.last is None else sum(was == now for was, now in rows.values())
    number = count_text(len(contents.now), "recording")
    told = told_once(((), key, why) for key, why in left_out.items())
    return value, [
        *_lines(why),
        f"made from {contents.part} of {number}{f', {same} as before' if same else ''}",
        *(_row(key, *row) for key, row in rows.items() if row[0] != row[1] or (keys and row[0])),
        *(f"left out: {one.title} ({one.text})" for one in told),
        *([f"no longer left out: {names_text(returned)}"] if returned else []),
    ]


def _of_own(
    target: "Target", key: str, state: "AssetState", found: "Evidence"
) -> tuple[JsonObject, list[str]]:
    """Return, as JSON and as lines, why an asset of the user's is in its state; `key` is empty for one of all recordings."""
    from bagassets.engine.targets import read_before

    before, reads = read_before(target, found), dict(found.now)
    value = {"key": key or None, "asset": target.name, **state.as_json(), "reads": reads, "recorded": before}
    rows = (
        _row(f"reads {name}", (before or {}).get(name) or None, now or None) for name, now in reads.items()
    )
    return value, [_head(value, key), *rows]


def _head(why: JsonObject, key: str) -> str:
    of_key, state = f" of {key}" if key else "", why["state"]
    reason = "" if state == "fresh" else f": {why['reason']}"  # which may hold parentheses
    return f"{why['asset']}{of_key} {'has failed' if state == 'failed' else f'is {state}'}{reason}"


def _lines(why: JsonObject) -> Iterator[str]:
    """Yield as lines of text why an asset of a recording, or a dataset, is in its state."""
    key, last = why.get("recording", ""), why["recorded"] or {}
    yield _head(why, key)
    # What a dataset would be made into, nobody knows; the code version of a recording is never another.
    data_version = why["data_version"] if key else last.get("data_version")
    code_version = why["code_version"] if why["asset"] != "bag" else last.get("code_version")
    yield _row("data version", last.get("data_version"), data_version, unknown="not known yet")
    yield _row("code version", last.get("code_version"), code_version)
    if last:
        yield f"  recorded by run {last['run_id']}" if last["run_id"] else "  recorded without a run"
    for pair in why.get("actions", ()):
        yield from _action_lines(pair)
    if key and why["asset"] != "bag" and not why["actions"]:
        yield "  Its action is not known: an input is not known yet, or the recording is skipped."


def _action_lines(pair: JsonMapping) -> Iterator[str]:
    from bagassets.engine.differences import flatten

    # If one of them is not known, there is nothing to compare, and the other is printed alone.
    last, now = pair["last"] or pair["now"] or {}, pair["now"] or pair["last"] or {}
    of = f" of {pair['channel']}" if pair["channel"] else ""
    remark = "" if pair["now"] is not None else ", as it was last; the current one is not known yet"
    remark = remark if pair["last"] is not None else ", the first one"
    yield f"action {now.get('step')}{of}{remark}"
    yield _row("digest", last.get("digest"), now.get("digest"))
    yield _row("version", last.get("version"), now.get("version"))
    for group, name_of in (("libraries", "library"), ("params", "param"), ("inputs", "input")):
        before, after = dict(flatten(last.get(group, {}))), dict(flatten(now.get(group, {})))
        names = sorted(before.keys() | after.keys())
        for name in names:
            if {} in (before.get(name), after.get(name)) and any(one.startswith(f"{name}.") for one in names):
                continue  # it was empty, and what is in it now has lines of its own, or the reverse
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
