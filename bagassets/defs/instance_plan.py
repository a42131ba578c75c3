"""The plan of a Dagster instance, from its records, the recordings on disk and the store, all read in bulk."""

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, replace

import dagster as dg

from bagassets.build.named_files import named_files
from bagassets.build.plan import BagPlan, Plan, Recorded
from bagassets.build.planner import plan_recordings
from bagassets.defs.events import all_assets, fetch_recorded, latest_ids, live_partitions
from bagassets.defs.naming import Naming
from bagassets.defs.workspace import Workspace
from bagassets.formats.dataset_build import DatasetInputs, select_inputs
from bagassets.freshness.fingerprints import PlanNeeded, loaded_code_fingerprint, project_fingerprint
from bagassets.garbage import uncollected
from bagassets.recordings.discover import Discovery

__all__ = [
    "InstancePlan",
    "plan_in_run",
    "plan_instance",
    "recorded_assets",
    "replan_instance",
    "workspace_fingerprint",
]


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

    def records_still_latest(
        self, ids: Mapping[str, Mapping[str, int]], keys: Iterable[str]
    ) -> dict[str, dict[str, Recorded]]:
        """Return partition key -> asset -> record, where `ids` (see `latest_ids`) names the record that this plan has."""
        return {
            key: {
                asset: record
                for asset, record in self.recorded.get(key, {}).items()
                if self.storage_ids[asset].get(key) == ids[asset].get(key)
            }
            for key in keys
        }


def plan_instance(
    instance: dg.DagsterInstance,
    workspace: Workspace,
    live: frozenset[str] | None = None,
    before: InstancePlan | None = None,
    on_planned: Callable[[int, int], None] | None = None,
) -> InstancePlan:
    """Plan everything; nothing is changed but what the next plan remembers.

    Args:
        instance: where materializations are recorded.
        workspace: recipe, store and recordings.
        live: partition keys to take as registered; default: those that are.
        before: an earlier plan, whose records are not fetched again where they are still the latest.
        on_planned: see `plan_recordings`.

    Raises:
        BagAssetsError: the recipe or the bag root is not usable.
    """
    live = live_partitions(instance, workspace.names) if live is None else live
    return _planned(instance, workspace, workspace.discover(), live, before=before, on_planned=on_planned)


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
        on_planned: see `plan_recordings`.
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
    planned = _planned(
        instance,
        workspace,
        replace(before.discovery, recordings=there),
        live,
        ids,
        kept,
        on_planned=on_planned,
    )
    same = {key: recorded for key, recorded in before.recorded.items() if key in kept}
    return replace(planned, recorded={**same, **planned.recorded})


def plan_in_run(context: dg.AssetExecutionContext, workspace: Workspace) -> InstancePlan:
    """Return the plan of a run, made once, so that all datasets that the run makes have the same inputs."""
    return workspace.once_in_run(context.run.run_id, lambda: plan_instance(context.instance, workspace))


def _planned(
    instance: dg.DagsterInstance,
    workspace: Workspace,
    discovery: Discovery,
    live: frozenset[str],
    ids: Mapping[str, Mapping[str, int]] | None = None,
    kept: Mapping[str, BagPlan] | None = None,
    before: InstancePlan | None = None,
    on_planned: Callable[[int, int], None] | None = None,
) -> InstancePlan:
    ids = latest_ids(instance, workspace.names, all_assets()) if ids is None else ids

    def fetch(keys: Iterable[str]) -> dict[str, dict[str, Recorded]]:
        if before is None:
            return fetch_recorded(instance, workspace.names, ids, keys)
        known = before.records_still_latest(ids, keys)
        missing = {
            asset: {key: by_key[key] for key in known if key in by_key and asset not in known[key]}
            for asset, by_key in ids.items()
        }
        fetched = fetch_recorded(instance, workspace.names, missing, known)
        return {key: {**known[key], **records} for key, records in fetched.items()}

    with uncollected():
        plan, recorded = plan_recordings(
            workspace.assets,
            workspace.store,
            discovery,
            live,
            workspace.index,
            project=workspace_fingerprint(workspace),
            storage_ids=ids,
            fetch=fetch,
            kept=kept,
            on_planned=on_planned,
        )
    return InstancePlan(plan, recorded, select_inputs(plan, live), discovery, live, ids)


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
