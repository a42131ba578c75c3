"""Why an asset of a recording is in its state: its current action beside the last recorded one."""

import json

from bagassets.base.json_types import JsonMapping, JsonObject
from bagassets.engine.differences import compare_actions
from bagassets.engine.graph import Graph, Node
from bagassets.engine.plan import AssetState, Recorded
from bagassets.store.canonical import digest_json
from bagassets.store.store import Store

_SHOWN = ("data_version", "code_version", "run_id", "cached")  # of what is recorded


def explanation(
    asset: str, state: AssetState, recorded: Recorded | None, code_version: str | None
) -> JsonObject:
    """Return why an asset, or a dataset, is in its state, as JSON.

    Args:
        asset: its name.
        state: its state and reason.
        recorded: what Dagster recorded last, or None.
        code_version: what Dagster's code version would be now; None for `bag`.
    """
    last = recorded and {name: getattr(recorded, name) for name in _SHOWN}
    return {"asset": asset, **state.as_json(), "code_version": code_version, "recorded": last}


def explain_asset(graph: Graph, asset: str) -> JsonObject:
    """Return why an asset of a recording is in its state, as JSON; see `explanation`.

    `actions` has a pair for each channel that it extracts, or a single one, whose `channel` is None; there are none of
    `bag`, which no action makes. `now` is the current action, None if its inputs are not known yet; `last` is the one that
    Dagster recorded last, or None; `changes` are their differences, if both are known.

    Args:
        graph: of the recording, beside what is on record (`recorded_graph`).
        asset: one of the recording's assets.
    """
    state, last = graph.states()[asset], graph.recorded.get(asset)
    pairs: list[JsonObject] = []
    if asset != "bag":
        now = _actions_now(graph.node(asset))
        before = _actions_of(graph.store, None if last is None else last.action)
        names = sorted(now.keys() | before.keys())
        if names != [""]:
            names = [name for name in names if name]  # the index of channels has nothing to add
        pairs = [_pair(name, now.get(name), before.get(name)) for name in names]
    value = explanation(asset, state, last, graph.assets.versions.get(asset))
    return {"recording": graph.recording.key, **value, "actions": pairs}


def _pair(channel: str, now: JsonMapping | None, last: JsonMapping | None) -> JsonObject:
    changes = [] if now is None or last is None else compare_actions(last, now)
    return {
        "channel": channel or None,
        "now": now and {"digest": digest_json(dict(now)), **now},
        "last": last and {"digest": digest_json(dict(last)), **last},
        "changes": [vars(change) for change in changes],
    }


def _actions_now(node: Node) -> dict[str, JsonMapping]:
    """Return the actions of an asset's channels by name, or its own under "", as far as they are known."""
    return {
        one.channel: json.loads(json.dumps(one.action.as_json()))
        for one in node.below
        if one.action is not None
    }


def _actions_of(store: Store, digest: str | None) -> dict[str, JsonMapping]:
    """Return the actions of an asset's channels by name, or the action itself under "" if it has none."""
    action = None if digest is None else store.action(digest)
    if action is None:
        return {}
    channels = action["params"].get("actions") if action["step"].endswith("_index") else None
    if not channels:
        return {"": action}
    actions = {name: store.action(digest) for name, digest in channels.items()}
    return {name: inner for name, inner in actions.items() if inner is not None}
