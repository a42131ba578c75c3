"""Why an asset of a recording is in its state: its current action beside the last recorded one."""

import json
from collections.abc import Mapping
from dataclasses import dataclass

from bagassets.base.json_types import JsonMapping, JsonObject
from bagassets.engine.differences import Change, compare_actions
from bagassets.engine.graph import Node
from bagassets.engine.plan import AssetState, Recorded
from bagassets.engine.planner import Planner
from bagassets.recordings.model import RecordingFiles
from bagassets.store.canonical import digest_json
from bagassets.store.store import Store

__all__ = ["ActionPair", "Explanation", "explain_asset"]

_SHOWN = ("data_version", "code_version", "run_id", "cached")  # of what is recorded


@dataclass(frozen=True)
class ActionPair:
    """The current action and the one that Dagster recorded last.

    Attributes:
        channel: the channel that it extracts, or "" for an asset with a single action.
        now: the current action as JSON; None if its inputs are not known yet.
        last: the last recorded action as JSON; None if there is none.
    """

    channel: str
    now: JsonMapping | None
    last: JsonMapping | None

    @property
    def changes(self) -> list[Change]:
        """The differences; empty unless both actions are known."""
        return compare_actions(self.last, self.now) if self.now is not None and self.last is not None else []

    def as_json(self) -> JsonObject:
        """Return the pair as JSON."""
        return {
            "channel": self.channel or None,
            "now": _with_digest(self.now),
            "last": _with_digest(self.last),
            "changes": [vars(change) for change in self.changes],
        }


@dataclass(frozen=True)
class Explanation:
    """Why an asset is in its state.

    Attributes:
        key: partition key; empty for a dataset.
        asset: asset.
        state: its state and reason.
        recorded: what Dagster recorded last, or None.
        code_version: what Dagster's code version would be now; None for `bag`.
        actions: its actions; none for `bag` and datasets, which no action makes.
    """

    key: str
    asset: str
    state: AssetState
    recorded: Recorded | None
    code_version: str | None
    actions: tuple[ActionPair, ...] = ()

    def as_json(self) -> JsonObject:
        """Return the explanation as JSON."""
        last = self.recorded
        value = {
            "asset": self.asset,
            **self.state.as_json(),
            "code_version": self.code_version,
            "recorded": last and {name: getattr(last, name) for name in _SHOWN},
        }
        if not self.key:
            return value
        return {"recording": self.key, **value, "actions": [pair.as_json() for pair in self.actions]}


def explain_asset(
    planner: Planner, recording: RecordingFiles, recorded: Mapping[str, Recorded], asset: str
) -> Explanation:
    """Return why an asset of a recording is in its state.

    Args:
        planner: decides.
        recording: its files.
        recorded: asset -> what Dagster recorded last.
        asset: one of the recording's assets.
    """
    graph = planner.graph(recording, recorded)
    state = graph.states()[asset]
    last = recorded.get(asset)
    pairs: tuple[ActionPair, ...] = ()
    if asset != "bag":
        now = _actions_now(graph.node(asset))
        before = _actions_of(planner.store, None if last is None else last.action)
        names = sorted(now.keys() | before.keys())
        if names != [""]:
            names = [name for name in names if name]  # the index of channels has nothing to add
        pairs = tuple(ActionPair(name, now.get(name), before.get(name)) for name in names)
    return Explanation(recording.key, asset, state, last, planner.assets.versions.get(asset), pairs)


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


def _with_digest(action: JsonMapping | None) -> JsonObject | None:
    return None if action is None else {"digest": digest_json(dict(action)), **action}
