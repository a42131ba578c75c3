"""The plan for thousands of recordings: those that are as they were are not looked into again."""

from collections.abc import Callable, Iterable, Mapping

from bagassets.build.named_files import files_beside
from bagassets.build.plan import Planner
from bagassets.build.plan_model import BagPlan, Plan, Recorded
from bagassets.build.recording_assets import RecordingAssets
from bagassets.freshness.plan_cache import PlanCache, recording_fingerprint
from bagassets.recordings.digest import DigestIndex
from bagassets.recordings.discover import Discovery
from bagassets.store.store import Store

__all__ = ["plan_in_bulk"]

Fetch = Callable[[Iterable[str]], Mapping[str, Mapping[str, Recorded]]]


def plan_in_bulk(
    assets: RecordingAssets,
    store: Store,
    discovery: Discovery,
    registered: frozenset[str],
    index: DigestIndex,
    *,
    project: str | None,
    storage_ids: Mapping[str, Mapping[str, int]],
    fetch: Fetch,
    kept: Mapping[str, BagPlan] | None = None,
) -> tuple[Plan, dict[str, Mapping[str, Recorded]]]:
    """Decide for all recordings.

    Args:
        assets: what recordings have under the recipe.
        store: the artifact store.
        discovery: the recordings on disk.
        registered: the live partition keys.
        index: our own index of digests of files.
        project: fingerprint of the code, the recipe and the files that it names; None has all recordings examined.
        storage_ids: asset -> partition key -> id of what Dagster recorded last.
        fetch: given partition keys, returns for each what Dagster recorded last, by asset.
        kept: states of recordings that are taken as they are.

    Returns:
        The plan, and what Dagster recorded of those recordings that had to be looked into.
    """
    cache = PlanCache(assets.recipe.state, store.root / "artifacts")
    before = cache.load()
    fingerprints: dict[str, str] = {}
    bags: dict[str, BagPlan] = dict(kept or {})
    for key, recording in discovery.recordings.items():
        if project is None:
            break
        if key in bags:
            continue
        ids = {asset: keys[key] for asset, keys in storage_ids.items() if key in keys}
        fingerprints[key] = recording_fingerprint(
            project,
            recording.relative,
            recording.files,
            files_beside(assets.recipe, recording),
            ids if key in registered else {},
        )
        entry = before.get(key)
        if entry is not None and entry.recording_fingerprint == fingerprints[key]:
            plan = BagPlan.from_row(key, entry.plan)
            if cache.holds(entry, plan.artifacts):
                bags[key] = plan
            else:
                _take_out_damaged(store, plan)
    as_they_were = frozenset(bags)
    others = [key for key in discovery.recordings if key not in bags]
    recorded = fetch(key for key in others if key in registered)
    planner = Planner(assets, store, index)
    bags |= {key: planner.plan(discovery.recordings[key], recorded.get(key, {})) for key in others}
    settled = {key: bags[key] for key in others if key in fingerprints and bags[key].settled}
    cache.save(
        {key: (fingerprints[key], plan.as_row(), plan.artifacts) for key, plan in settled.items()},
        before.keys() - as_they_were - settled.keys(),
    )
    ordered = {key: bags[key] for key in discovery.recordings}
    return Plan(ordered, dict(discovery.excluded), discovery.removed(registered)), dict(recorded)


def _take_out_damaged(store: Store, plan: BagPlan) -> None:
    """Take artifacts out of the store that lack files, so that they are made again."""
    for digest in plan.artifacts:
        if store.has(digest) and not store.is_complete(digest):
            store.remove(digest)
