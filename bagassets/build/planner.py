"""Planning: deciding the state of every asset of every recording, and why.

The command line, the sensor and the status table all plan here. A planner reads Dagster's records, the store and the
files on disk; it runs nothing. Recordings that have not changed since the last plan are not examined again, so that
thousands of them can be planned.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace

from bagassets.build.graph import Graph
from bagassets.build.named_files import files_beside
from bagassets.build.plan import AssetState, BagPlan, Plan, Recorded, version_as_input
from bagassets.build.recording_assets import RecordingAssets
from bagassets.build.unsettled import Unsettled
from bagassets.freshness.plan_cache import PlanCache, recording_fingerprint
from bagassets.recordings.digest import DigestIndex, RecordingStat, stat_files, stored_digest
from bagassets.recordings.discover import Discovery
from bagassets.recordings.model import RecordingFiles
from bagassets.store.store import Store

__all__ = ["Planner", "plan_recordings"]

Fetch = Callable[[Iterable[str]], Mapping[str, Mapping[str, Recorded]]]

# Records of so many recordings are fetched at a time: as Dagster makes them, those of a thousand need 40 MB.
AT_A_TIME = 200


@dataclass
class Planner:
    """Plans single recordings.

    Attributes:
        assets: the assets of a recording under the recipe.
        store: the artifact store.
        index: index of file digests.
    """

    assets: RecordingAssets
    store: Store
    index: DigestIndex | None = None

    def plan(self, recording: RecordingFiles, recorded: Mapping[str, Recorded]) -> BagPlan:
        """Return the states of one recording.

        Args:
            recording: its files.
            recorded: asset -> what Dagster recorded last; empty if the partition does not exist.
        """
        graph = self.graph(recording, recorded)
        states = graph.states()
        channels = tuple(
            part.artifact.digest
            for name in self.assets.names
            if (node := graph.node(name)).artifact is not None
            for part in node.parts
            if part.artifact is not None
        )
        on_record = {asset: record.data_version for asset, record in recorded.items()}
        rig = "" if graph.rig is None else graph.rig.name
        touched = _is_touched(states["bag"], recorded.get("bag"), graph.stat)
        return BagPlan(
            recording.key,
            states,
            recording.format,
            on_record,
            channels,
            self.assets.optional,
            rig,
            touched,
            _outdated(states, recorded),
        )

    def graph(self, recording: RecordingFiles, recorded: Mapping[str, Recorded]) -> Graph:
        """Return the graph of one recording; see `plan`."""
        digest, stat, bag = _bag_state(recording, recorded.get("bag"), self.index)
        return Graph(self.assets, self.store, recording, digest, stat, bag=bag, recorded=recorded)


def _bag_state(
    recording: RecordingFiles, recorded: Recorded | None, index: DigestIndex | None
) -> tuple[str | None, RecordingStat, AssetState]:
    stats = stat_files(recording)
    stat = RecordingStat(tuple((path.name, s.st_size, s.st_mtime_ns) for path, s in stats))
    if recorded is not None and recorded.stat == stat:
        if index is None or not any(index.suspects_edit(path, s) for path, s in stats):
            state = AssetState("fresh", "size and time unchanged", recorded.data_version)
            return recorded.data_version, stat, state
        why = "size and time unchanged, but the file was touched since"
    else:
        why = "size or time changed"
    digest = stored_digest(recording, index)
    if recorded is None:
        return digest, stat, AssetState("missing", "new recording", digest)
    if digest == recorded.data_version:
        return digest, stat, AssetState("record-only", "touched, content unchanged", digest)
    reason = f"{why}: its content has to be read" if digest is None else "content changed"
    return digest, stat, AssetState("stale", reason, digest)


def _is_touched(state: AssetState, recorded: Recorded | None, stat: RecordingStat) -> bool:
    """See `BagPlan.touched`."""
    if recorded is None or recorded.stat is None or state.state not in {"stale", "record-only"}:
        return False
    return state.data_version in {None, recorded.data_version} and recorded.stat.sizes == stat.sizes


def _outdated(states: Mapping[str, AssetState], recorded: Mapping[str, Recorded]) -> frozenset[str]:
    """See `BagPlan.outdated`. What would be made again with the same bytes is not outdated."""
    if "bag" not in recorded:
        return frozenset()
    content, outdated = recorded["bag"].data_version, set()
    for name, record in recorded.items():
        if name in states and states[name].data_version == record.data_version:
            continue
        is_of_bag = record.content == content if record.content else _is_of_bag(name, recorded)
        if not is_of_bag:
            outdated.add(name)
    return frozenset(outdated)


def _is_of_bag(name: str, recorded: Mapping[str, Recorded]) -> bool:
    """Return whether an asset was made from what else is on record, up to `bag`."""
    read = {above: version for above, version in recorded[name].inputs.items() if above in recorded}
    return all(
        version_as_input(recorded[above].data_version) == version and _is_of_bag(above, recorded)
        for above, version in read.items()
    )


def plan_recordings(
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
    on_planned: Callable[[int, int], None] | None = None,
) -> tuple[Plan, dict[str, Mapping[str, Recorded]]]:
    """Plan all recordings.

    Args:
        assets: the assets of a recording under the recipe.
        store: the artifact store.
        discovery: the recordings on disk.
        registered: the existing partition keys.
        index: index of file digests.
        project: fingerprint of the code, the recipe and the files that it names; None has all recordings examined.
        storage_ids: asset -> partition key -> id of Dagster's latest record.
        fetch: returns partition key -> asset -> what Dagster recorded last.
        kept: states of recordings that are not planned again.
        on_planned: called, where it takes long, with how many recordings have been examined, and how many will be.

    Returns:
        The plan, and Dagster's records of the recordings that were examined.
    """
    cache = PlanCache(assets.recipe.state, store.root / "artifacts")
    before = cache.load()
    unsettled = Unsettled(assets.recipe.state).noted()
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
        entry = None if key in unsettled else before.get(key)
        if entry is not None and entry.recording_fingerprint == fingerprints[key]:
            plan = BagPlan.from_row(key, entry.plan)
            if cache.holds(entry, plan.artifacts):
                bags[key] = plan
            else:
                _remove_incomplete(store, plan)
    unchanged = frozenset(bags)
    others = [key for key in discovery.recordings if key not in bags]
    recorded: dict[str, Mapping[str, Recorded]] = {}
    planner = Planner(assets, store, index)
    for start in range(0, len(others), AT_A_TIME):
        some = others[start : start + AT_A_TIME]
        recorded |= fetch(key for key in some if key in registered)
        for key in some:
            bag = planner.plan(discovery.recordings[key], recorded.get(key, {}))
            bags[key] = _once_more(bag) if key in unsettled else bag
        if on_planned is not None and len(others) > AT_A_TIME:
            on_planned(start + len(some), len(others))
    settled = {key: bags[key] for key in others if key in fingerprints and bags[key].settled}
    cache.save(
        {key: (fingerprints[key], plan.as_row(), plan.artifacts) for key, plan in settled.items()},
        before.keys() - unchanged - settled.keys(),
    )
    ordered = {key: bags[key] for key in discovery.recordings}
    return Plan(ordered, dict(discovery.excluded), discovery.removed(registered)), recorded


def _once_more(bag: BagPlan) -> BagPlan:
    """Return the plan of a recording whose last run did not end well: what is up to date is recorded again.

    Not where anything failed: until that changes, a run would end no better. `bag` stays fresh, as its content is known.
    """
    if bag.failed is not None:
        return bag
    states = {
        name: AssetState("record-only", "up to date, but its last run did not end well", state.data_version)
        if state.state == "fresh" and name != "bag"
        else state
        for name, state in bag.assets.items()
    }
    return replace(bag, assets=states)


def _remove_incomplete(store: Store, plan: BagPlan) -> None:
    """Remove artifacts that lack files from the store, so that they are made again."""
    for digest in plan.artifacts:
        if store.has(digest) and not store.is_complete(digest):
            store.remove(digest)
