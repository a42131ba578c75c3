"""The datasets and the user's own assets, as `status` and `build --dry-run` show them: all alike."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

from bagassets.base.json_types import JsonObject

if TYPE_CHECKING:
    from bagassets.defs.builds.own_states import OwnWork
    from bagassets.defs.builds.pending_work import PendingWork
    from bagassets.engine.plan import AssetState

__all__ = ["target_states", "targets_json"]


def target_states(pending: "PendingWork", own: "OwnWork") -> dict[str, Mapping[str, "AssetState"]]:
    """Return what a build brings up to date besides assets of recordings -> partition key, "" for one of all -> state."""
    datasets = {name: {"": one} for name, one in pending.dataset_states.items()}
    return {**datasets, **{name: own.states.get(name, {}) for name in own.project.wanted}}


def targets_json(pending: "PendingWork", own: "OwnWork") -> JsonObject:
    """Return the same as JSON."""
    datasets = pending.dataset_states
    return {
        "datasets": {name: one.state for name, one in datasets.items()},
        "dataset_reasons": {name: one.reason for name, one in datasets.items() if one.state != "fresh"},
        "own": own.as_json(),
    }
