"""The plan for thousands of recordings: those that are as they were are not looked into again."""

from collections.abc import Callable, Iterable, Mapping

from bagassets.bags.digest import DigestIndex
from bagassets.bags.discover import Discovery
from bagassets.engine.named_files import files_beside
from bagassets.engine.plan import Plan, Planner, Recorded
from bagassets.engine.plan_memo import PlanMemo, Remembered, artifacts_of, fingerprint, signatures
from bagassets.engine.plan_model import BagPlan
from bagassets.recipe.model import Recipe
from bagassets.store.store import Store

__all__ = ["plan_in_bulk"]

Fetch = Callable[[Iterable[str]], Mapping[str, Mapping[str, Recorded]]]


def plan_in_bulk(
    recipe: Recipe,
    store: Store,
    discovery: Discovery,
    registered: frozenset[str],
    index: DigestIndex,
    *,
    memo: PlanMemo,
    stamp: str,
    storage_ids: Mapping[str, Mapping[str, int]],
    fetch: Fetch,
) -> tuple[Plan, dict[str, Mapping[str, Recorded]]]:
    """Decide for all recordings.

    Args:
        recipe: the recipe.
        store: the artifact store.
        discovery: the recordings on disk.
        registered: the live partition keys.
        index: our own index of digests of files.
        memo: what the last plan found.
        stamp: digest of recipe, code and libraries.
        storage_ids: asset -> partition key -> id of what Dagster recorded last.
        fetch: given partition keys, returns for each what Dagster recorded last, by asset.

    Returns:
        The plan, and what Dagster recorded of those recordings that had to be looked into.
    """
    before = memo.load()
    marks = {}
    bags: dict[str, BagPlan] = {}
    for key, found in discovery.found.items():
        ids = {asset: keys[key] for asset, keys in storage_ids.items() if key in keys}
        try:
            beside = files_beside(recipe, found)
            marks[key] = fingerprint(stamp, found, ids if key in registered else {}, beside)
        except OSError:
            continue  # removed meanwhile: the planner tells
        entry = before.get(key)
        if entry is not None and entry.fingerprint == marks[key] and _holds(store, entry):
            bags[key] = entry.plan
    others = [key for key in discovery.found if key not in bags]
    recorded = fetch(key for key in others if key in registered)
    planner = Planner(recipe, store, index)
    learned = []
    for key in others:
        plan = planner.plan(discovery.found[key], recorded.get(key, {}))
        bags[key] = plan
        if plan.settled and key in marks and (found_now := signatures(store, plan)) is not None:
            learned.append(Remembered(marks[key], plan, found_now))
    unsettled = [key for key in others if key in before and not bags[key].settled]
    memo.save(learned, [*unsettled, *(before.keys() - discovery.found.keys())])
    ordered = {key: bags[key] for key in discovery.found}
    return Plan(ordered, dict(discovery.excluded), discovery.removed(registered)), dict(recorded)


def _holds(store: Store, entry: Remembered) -> bool:
    """Tell whether the artifacts of a recording are as they were; a damaged one is taken out of the store."""
    if signatures(store, entry.plan) == entry.signatures:
        return True
    for digest in artifacts_of(entry.plan):
        if store.has(digest) and not store.is_complete(digest):
            store.remove(digest)
    return False
