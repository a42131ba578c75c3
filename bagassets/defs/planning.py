"""The plan as it is now: Dagster's records, the recordings on disk and the store, read in bulk."""

import gc
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import dagster as dg

from bagassets.bags.discover import Discovery
from bagassets.defs.events import fetch_recorded, latest_ids, live_partitions
from bagassets.defs.workspace import Workspace
from bagassets.engine.dataset_build import DatasetInputs, select_inputs
from bagassets.engine.named_files import file_signature, named_files
from bagassets.engine.plan_bulk import plan_in_bulk
from bagassets.engine.plan_memo import PlanMemo
from bagassets.engine.plan_model import Plan, Recorded
from bagassets.forkserver.tasks import server_spec
from bagassets.recipe.model import Recipe
from bagassets.store.canonical import digest_json

__all__ = ["Planned", "plan_now", "plan_stamp", "recorded_of"]


@dataclass(frozen=True)
class Planned:
    """The plan and what it was decided from.

    Attributes:
        plan: state of each asset of each recording.
        recorded: partition key -> asset -> what Dagster recorded last, of recordings that had to be looked into.
        inputs: what a dataset would be made from.
        discovery: the recordings on disk.
        live: the registered partition keys.
    """

    plan: Plan
    recorded: Mapping[str, Mapping[str, Recorded]]
    inputs: DatasetInputs
    discovery: Discovery
    live: frozenset[str]


def plan_now(
    instance: dg.DagsterInstance, workspace: Workspace, live: frozenset[str] | None = None
) -> Planned:
    """Look at everything and decide, changing nothing but the memory of the next plan.

    Args:
        instance: where materializations are recorded.
        workspace: recipe, store and recordings.
        live: partition keys taken as registered; default: those that are.

    Raises:
        BagAssetsError: the recipe or the bag root is not usable.
    """
    recipe, discovery = workspace.recipe, workspace.discover()
    live = live_partitions(instance, recipe) if live is None else live
    ids = latest_ids(instance)

    def fetch(keys: Iterable[str]) -> dict[str, dict[str, Recorded]]:
        return fetch_recorded(instance, ids, keys)

    with _uncollected():
        plan, recorded = plan_in_bulk(
            recipe,
            workspace.store,
            discovery,
            live,
            workspace.index,
            memo=PlanMemo(recipe.state),
            stamp=plan_stamp(workspace),
            storage_ids=ids,
            fetch=fetch,
        )
    return Planned(plan, recorded, select_inputs(plan, live), discovery, live)


@contextmanager
def _uncollected() -> Iterator[None]:
    """Keep the garbage collector from looking through a growing plan again and again: a third of its time."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


def recorded_of(instance: dg.DagsterInstance, recipe: Recipe, key: str) -> Mapping[str, Recorded]:
    """Return asset -> what Dagster recorded last of one recording; nothing if it is not registered."""
    if key not in live_partitions(instance, recipe):
        return {}
    return fetch_recorded(instance, latest_ids(instance), [key])[key]


def plan_stamp(workspace: Workspace) -> str:
    """Return the digest of recipe, code, libraries and the files that the recipe names.

    Unlike that of a server it leaves out the environment, so that command line, daemon and workers
    agree.
    """
    recipe = workspace.recipe
    spec = server_spec(recipe.state, Path(workspace.recipe_file))
    files = [[str(path), *file_signature(path)] for path in named_files(recipe)]
    return digest_json([replace(spec, environment={}, paths=()).stamp(), files])
