"""The current artifact of an asset, as a plan knows it."""

from bagassets.build.plan_model import BagPlan
from bagassets.store.artifact import Artifact
from bagassets.store.store import Store

__all__ = ["current_artifact"]


def current_artifact(store: Store, bag: BagPlan, asset: str) -> Artifact | None:
    """Return what is current of an asset, else what was recorded last, if the store still has it."""
    state = bag.assets.get(asset)
    for digest in (state.data_version if state else None, bag.recorded.get(asset)):
        if digest and store.has(digest):
            return store.artifact(digest)
    return None
