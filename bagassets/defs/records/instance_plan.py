"""The plan of a Dagster instance, from its records, the recordings on disk and the store, all read in bulk."""

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import NamedTuple

import dagster as dg

from bagassets.base.fingerprints import PlanNeeded, loaded_code_fingerprint, project_fingerprint
from bagassets.base.garbage import uncollected
from bagassets.defs.records.events import all_assets, fetch_recorded, latest_ids, live_partitions
from bagassets.defs.records.naming import Naming
from bagassets.defs.records.workspace import Workspace
from bagassets.engine.inputs import named_files
from bagassets.engine.plan import BagPlan, Plan, Recorded
from bagassets.engine.planner import Planning
from bagassets.formats.checking import quick_findings
from bagassets.formats.dataset_build import DatasetInputs, select_inputs
from bagassets.recordings.discover import Discovery
from bagassets.recordings.model import RecordingFiles


@dataclass(frozen=True)
class InstancePlan:
    """A plan and what it was made from.

    Attributes:
        plan: state of each asset of each recording.
        recorded: partition key -> asset -> latest record in Dagster, for the recordings that had to be planned in full.
        inputs: the inputs of the datasets.
        discovery: the recordings on disk.
        live: the registered partition keys.
        storage_ids: asset -> partition key -> storage id of the latest record.
    """

    plan: Plan
    recorded: Mapping[str, Mapping[str, Recorded]]
    inputs: DatasetInputs
    discovery: Discovery
    live: frozenset[str]
    storage_ids: Mapping[str, Mapping[str, int]]

    def latest(self, key: str) -> list[int | None]:
        """Return values that change with every new record of a recording, and when its partition comes or goes."""
        return [ids.get(key) if key in self.live else None for ids in self.storage_ids.values()]


class Touched(NamedTuple):
    """A recording of which only the time seems to have changed.

    Attributes:
        recording: its files.
        recorded: the latest record of `bag`.
    """

    recording: RecordingFiles
    recorded: Recorded


def begin_planning(
    instance: dg.DagsterInstance,
    workspace: Workspace,
    live: frozenset[str] | None = None,
    discovery: Discovery | None = None,
    ids: Mapping[str, Mapping[str, int]] | None = None,
    kept: Mapping[str, BagPlan] = MappingProxyType({}),
    *,
    thorough: bool = True,
) -> Planning:
    """Return what plans everything, from what Dagster's records and the folders are now.

    Args:
        instance: where materializations are recorded.
        workspace: recipe, store and recordings.
        live: partition keys to take as registered; default: those that are.
        discovery: recordings to take as being on disk; default: those that are.
        ids: see `InstancePlan.storage_ids`; default: as they are.
        kept: states of recordings that are not planned again.
        thorough: see `Planning`.

    Raises:
        BagAssetsError: the recipe or the bag root is not usable.
    """
    names = workspace.names
    found = workspace.discover() if discovery is None else discovery
    latest = latest_ids(instance, names, all_assets()) if ids is None else ids

    def fetch(assets: Iterable[str], keys: Iterable[str]) -> dict[str, dict[str, Recorded]]:
        return fetch_recorded(instance, names, {asset: latest[asset] for asset in assets}, keys)

    with uncollected():
        return Planning(
            workspace.assets,
            workspace.store,
            found,
            live_partitions(instance, names) if live is None else live,
            workspace.index,
            workspace_fingerprint(workspace),
            latest,
            fetch,
            kept,
            lambda bag: quick_findings(workspace.recipe, workspace.store, found, bag),
            thorough=thorough,
        )


def plan_instance(
    instance: dg.DagsterInstance,
    workspace: Workspace,
    planning: Planning | None = None,
    on_planned: Callable[[int, int], None] | None = None,
) -> InstancePlan:
    """Plan everything; nothing is changed but what the next plan remembers.

    Args:
        instance: where materializations are recorded.
        workspace: recipe, store and recordings.
        planning: what plans; default: a new one (see `begin_planning`).
        on_planned: see `Planning.plan`.
    """
    planning = planning or begin_planning(instance, workspace)
    with uncollected():
        plan, recorded = planning.plan(on_planned)
    discovery, live = planning.discovery, planning.registered
    return InstancePlan(plan, recorded, select_inputs(plan, live), discovery, live, planning.storage_ids)


def replan_instance(
    instance: dg.DagsterInstance,
    workspace: Workspace,
    before: InstancePlan,
    worked_on: Collection[str],
    on_planned: Callable[[int, int], None] | None = None,
) -> InstancePlan:
    """Plan again the recordings that runs may have changed; the others keep their plan.

    A recording whose files were removed meanwhile leaves the plan if it is planned again. Whatever else came, went or
    changed on disk is left to the next plan.

    Args:
        instance: where materializations are recorded.
        workspace: recipe, store and recordings.
        before: the plan that the runs were made from.
        worked_on: recordings that had a run; others with new records, whoever wrote them, are found by these
            records.
        on_planned: see `Planning.plan`.
    """
    live = live_partitions(instance, workspace.names)
    ids = latest_ids(instance, workspace.names, all_assets())
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
    discovery = replace(before.discovery, recordings=there)
    planning = begin_planning(instance, workspace, live, discovery, ids, kept)
    planned = plan_instance(instance, workspace, planning, on_planned)
    same = {key: records for key, records in before.recorded.items() if key in kept}
    return replace(planned, recorded={**same, **planned.recorded})


def recorded_assets(instance: dg.DagsterInstance, names: Naming, key: str) -> Mapping[str, Recorded]:
    """Return asset -> latest record of one recording; nothing if it is not registered."""
    if key not in live_partitions(instance, names):
        return {}
    return fetch_recorded(instance, names, latest_ids(instance, names, all_assets()), [key])[key]


def workspace_fingerprint(workspace: Workspace) -> str | None:
    """Return the fingerprint of code, recipe and the files that it names; None if one cannot be read."""
    files, folders = named_files(workspace.recipe)
    try:
        return project_fingerprint(
            loaded_code_fingerprint(), workspace.recipe_fingerprint, [*map(str, files)], [*map(str, folders)]
        )
    except PlanNeeded:
        return None
