"""The plan as it is now: Dagster's records, the recordings on disk and the store, read in bulk."""

import gc
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace

import dagster as dg

from bagassets.build.named_files import named_files
from bagassets.build.plan_bulk import plan_in_bulk
from bagassets.build.plan_model import BagPlan, Plan, Recorded
from bagassets.defs.events import fetch_recorded, latest_ids, live_partitions
from bagassets.defs.workspace import Workspace
from bagassets.formats.dataset_build import DatasetInputs, select_inputs
from bagassets.freshness.fingerprints import PlanNeeded, loaded_code_fingerprint, project_fingerprint
from bagassets.recipe.model import Recipe
from bagassets.recordings.discover import Discovery

__all__ = ["Planned", "plan_again", "plan_now", "plan_of_run", "project_of", "recorded_of"]


@dataclass(frozen=True)
class Planned:
    """The plan and what it was decided from.

    Attributes:
        plan: state of each asset of each recording.
        recorded: partition key -> asset -> what Dagster recorded last, of recordings that had to be looked into.
        inputs: what a dataset would be made from.
        discovery: the recordings on disk.
        live: the registered partition keys.
        storage_ids: asset -> partition key -> id of what Dagster recorded last.
    """

    plan: Plan
    recorded: Mapping[str, Mapping[str, Recorded]]
    inputs: DatasetInputs
    discovery: Discovery
    live: frozenset[str]
    storage_ids: Mapping[str, Mapping[str, int]]

    def latest(self, key: str) -> list[int | None]:
        """Return what tells whether something was recorded of a recording, or its partition came or went."""
        return [ids.get(key) if key in self.live else None for ids in self.storage_ids.values()]


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
    live = live_partitions(instance, workspace.recipe) if live is None else live
    return _planned(instance, workspace, workspace.discover(), live)


def plan_again(
    instance: dg.DagsterInstance, workspace: Workspace, before: Planned, worked_on: Collection[str]
) -> Planned:
    """Decide again where runs may have changed something: the other recordings stay as they were planned.

    Of those that are decided about again, the ones whose files were removed meanwhile are gone from the plan; what
    else came, went or changed on disk since is left to the next plan.

    Args:
        instance: where materializations are recorded.
        workspace: recipe, store and recordings.
        before: the plan that runs were begun from.
        worked_on: recordings that had a run; others of which something was recorded meanwhile, by whomever, are
            found by their records.
    """
    live = live_partitions(instance, workspace.recipe)
    ids = latest_ids(instance)
    now = replace(before, live=live, storage_ids=ids)
    kept = {
        key: bag
        for key, bag in before.plan.bags.items()
        if key not in worked_on and now.latest(key) == before.latest(key)
    }
    there = {
        key: recording
        for key, recording in before.discovery.recordings.items()
        if key in kept or all(path.exists() for path in recording.files)
    }
    planned = _planned(instance, workspace, replace(before.discovery, recordings=there), live, ids, kept)
    return replace(planned, recorded={**before.recorded, **planned.recorded})


def plan_of_run(context: dg.AssetExecutionContext, workspace: Workspace) -> Planned:
    """Decide once in a run: all that it puts together is made from the same."""
    return workspace.once_in_run(context.run.run_id, lambda: plan_now(context.instance, workspace))


def _planned(
    instance: dg.DagsterInstance,
    workspace: Workspace,
    discovery: Discovery,
    live: frozenset[str],
    ids: Mapping[str, Mapping[str, int]] | None = None,
    kept: Mapping[str, BagPlan] | None = None,
) -> Planned:
    ids = latest_ids(instance) if ids is None else ids

    def fetch(keys: Iterable[str]) -> dict[str, dict[str, Recorded]]:
        return fetch_recorded(instance, ids, keys)

    with _uncollected():
        plan, recorded = plan_in_bulk(
            workspace.assets,
            workspace.store,
            discovery,
            live,
            workspace.index,
            project=project_of(workspace),
            storage_ids=ids,
            fetch=fetch,
            kept=kept,
        )
    return Planned(plan, recorded, select_inputs(plan, live), discovery, live, ids)


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


def project_of(workspace: Workspace) -> str | None:
    """Return the fingerprint of the code, the recipe and the files that it names; None if something cannot be read."""
    files, folders = named_files(workspace.recipe)
    try:
        return project_fingerprint(
            loaded_code_fingerprint(), workspace.recipe_fingerprint, [*map(str, files)], [*map(str, folders)]
        )
    except PlanNeeded:
        return None
