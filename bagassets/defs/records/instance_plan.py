"""The plan of a Dagster instance, from its records, the recordings on disk and the store, all read in bulk."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from functools import partial
from types import MappingProxyType

from bagassets.base.fingerprints import PlanNeeded, loaded_code_fingerprint, project_fingerprint
from bagassets.base.garbage import uncollected
from bagassets.defs.records.latest_ids import latest_ids
from bagassets.defs.records.workspace import Workspace
from bagassets.engine.freshness.plan_cache import Checked
from bagassets.engine.inputs import named_files
from bagassets.engine.plan import BagPlan, Plan
from bagassets.engine.planner import Planner
from bagassets.formats.checking import findings_to_keep
from bagassets.recordings.discover import Discovery


def planner_of(
    workspace: Workspace,
    live: frozenset[str] | None = None,
    discovery: Discovery | None = None,
    ids: Mapping[str, Mapping[str, int]] | None = None,
    kept: Mapping[str, BagPlan] = MappingProxyType({}),
    checked: Checked = "all",
) -> Planner:
    """Return what plans everything, from what Dagster's records and the folders are now.

    Args:
        workspace: recipe, store, records and recordings.
        live: partition keys to take as registered; default: those that are.
        discovery: recordings to take as being on disk; default: those that are.
        ids: see `Plan.storage_ids`; default: as they are.
        kept: see `Planner`.
        checked: see `PlanCache`.

    Raises:
        BagAssetsError: the recipe or the bag root is not usable.
    """
    records, found = workspace.records, workspace.discover() if discovery is None else discovery
    with uncollected():
        return Planner(
            workspace.assets,
            found,
            records.live() if live is None else live,
            workspace_fingerprint(workspace),
            latest_ids(workspace) if ids is None else ids,
            records.fetch,
            kept,
            partial(findings_to_keep, workspace.assets, found),
            checked,
        )


def plan_instance(workspace: Workspace, found: Discovery | None = None, made: Collection[str] = ()) -> Plan:
    """Plan everything.

    Args:
        workspace: recipe, store, records and recordings.
        found: recordings on disk when a run began that a build or the sensor has launched, which have checked a sample of the
            artifacts, and will again; default: recordings as they are, and a sample is checked.
        made: those that the run has made since.
    """
    if found is None:
        return planner_of(workspace, checked="sample").plan()
    return planner_of(workspace, discovery=_looked_at_again(found, made), checked="fewest").plan()


def replan_instance(
    workspace: Workspace,
    before: Plan,
    worked_on: Collection[str],
    on_planned: Callable[[int, int], None] | None = None,
) -> Plan:
    """Plan again the recordings that runs may have changed; the others keep their plan.

    A recording whose files were removed meanwhile leaves the plan if it is planned again. Whatever else came, went or
    changed on disk is left to the next plan.

    Args:
        workspace: recipe, store, records and recordings.
        before: the plan that the runs were made from.
        worked_on: recordings that had a run; others with new records, whoever wrote them, are found by these
            records.
        on_planned: see `Planner.plan`.
    """
    live, ids = workspace.records.live(), latest_ids(workspace)
    changed = {*worked_on, *(live ^ before.live)}
    for asset, now in ids.items():
        if now != (last := before.storage_ids[asset]):
            changed.update(key for key, _ in now.items() ^ last.items())
    kept = {key: bag for key, bag in before.bags.items() if key not in changed}
    discovery = _looked_at_again(before.discovery, changed)
    planner = planner_of(workspace, live, discovery, ids, kept, "changed")
    plan = planner.plan(on_planned)
    same = {key: records for key, records in before.recorded.items() if key in planner.kept}
    return replace(plan, recorded={**same, **plan.recorded})


def _looked_at_again(found: Discovery, keys: Collection[str]) -> Discovery:
    """Return recordings without some that are gone by now, and without signatures of files that runs have stored digests with."""
    there = dict(found.recordings)
    for key in frozenset(keys) & there.keys():
        there[key] = replace(there[key], seen=())
        if not all(path.exists() for path in there[key].files):
            del there[key]
    return replace(found, recordings=there)


def workspace_fingerprint(workspace: Workspace) -> str | None:
    """Return the fingerprint of code, recipe and the files that it names; None if one cannot be read."""
    files, folders = named_files(workspace.recipe)
    try:
        return project_fingerprint(
            loaded_code_fingerprint(), workspace.recipe_fingerprint, [*map(str, files)], [*map(str, folders)]
        )
    except PlanNeeded:
        return None
