"""Planning: deciding the state of every asset of every recording, and why.

The command line, the sensor and the status table all plan here. A planner reads Dagster's records, the store and the
files on disk; it runs nothing. Recordings that have not changed since the last plan are not examined again, so that
thousands of them can be planned.
"""

import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace

from bagassets.assets.inventory import INVENTORY
from bagassets.base.alike import names_text
from bagassets.base.errors import StoreError
from bagassets.base.fingerprints import PlanNeeded
from bagassets.base.garbage import uncollected
from bagassets.engine.freshness.artifacts import SIZE, note_of
from bagassets.engine.freshness.plan_cache import (
    CachedPlan,
    Checked,
    PlanCache,
    RecordingFingerprint,
    recording_fingerprint,
)
from bagassets.engine.graph import Graph
from bagassets.engine.inputs import files_beside
from bagassets.engine.plan import AssetState, BagPlan, KeptPlan, Plan, Recorded, version_as_input
from bagassets.engine.recording_assets import RecordingAssets
from bagassets.engine.splits import Ties
from bagassets.engine.unsettled import Unsettled
from bagassets.recordings.digest import RecordingStat, stat_files, stored_digest
from bagassets.recordings.digest_record import DigestIndex
from bagassets.recordings.discover import Discovery
from bagassets.recordings.model import RecordingFiles
from bagassets.store.store import Store

Fetch = Callable[[Mapping[str, Mapping[str, int]], Iterable[str]], Mapping[str, Mapping[str, Recorded]]]

# Records of so many recordings are fetched at a time: as Dagster makes them, those of a thousand need 40 MB.
AT_A_TIME = 200


def recorded_graph(
    assets: RecordingAssets, recording: RecordingFiles, recorded: Mapping[str, Recorded]
) -> Graph:
    """Return the graph of a recording beside what is on record; nothing is read of the recording.

    Args:
        assets: the assets of a recording under the recipe.
        recording: its files.
        recorded: asset -> what Dagster recorded last; empty if the partition does not exist.
    """
    digest, stat, bag = _bag_state(recording, recorded.get("bag"), assets.index)
    return Graph(assets, recording, digest, stat, bag=bag, recorded=recorded)


def plan_recording(graph: Graph) -> BagPlan:
    """Return the states of one recording, from its `recorded_graph`."""
    recorded, states = graph.recorded, graph.states()
    channels = tuple(
        part.artifact.digest
        for name in graph.assets.names
        if (node := graph.node(name)).artifact is not None
        for part in node.parts
        if part.artifact is not None
    )
    made = {asset: record for asset, record in recorded.items() if not record.is_skip}
    return BagPlan(
        graph.recording.key,
        states,
        graph.recording.format,
        {asset: record.data_version for asset, record in made.items()},
        channels,
        graph.assets.optional,
        "" if graph.rig is None else graph.rig.name,
        _is_touched(states["bag"], recorded.get("bag"), graph.stat),
        _outdated(states, made),
    )


def _bag_state(
    recording: RecordingFiles, recorded: Recorded | None, index: DigestIndex
) -> tuple[str | None, RecordingStat, AssetState]:
    stats = stat_files(recording)
    stat = RecordingStat(tuple((path.name, s.st_size, s.st_mtime_ns) for path, s in stats))
    digest = stored_digest(recording, index)
    if recorded is not None and recorded.stat == stat:
        is_suspect = any(index.suspects_edit(path, s) for path, s in stats)
        # Edited in place and hashed since, it has the size and time on record, and another digest.
        if not is_suspect and digest in {None, recorded.data_version}:
            state = AssetState("fresh", "size and time unchanged", recorded.data_version)
            return recorded.data_version, stat, state
        why = "size and time unchanged, but the file was touched since"
    else:
        why = "size or time changed"
    refused = [path for path, _ in stats if digest is None and not os.access(path, os.R_OK)]
    but = f", but {refused[0]} cannot be read; correct its permissions" if refused else ""
    if recorded is None:
        return digest, stat, AssetState("missing", f"new recording{but}", digest)
    if digest == recorded.data_version:
        return digest, stat, AssetState("record-only", "touched, content unchanged", digest)
    differing = _differing_parts(recording, recorded.stat, stat)
    changed = f"content changed: {differing}" if differing else "content changed"
    reason = f"{differing or why}; its content has to be read{but}" if digest is None else changed
    return digest, stat, AssetState("stale", reason, digest)


def _differing_parts(recording: RecordingFiles, before: RecordingStat | None, now: RecordingStat) -> str:
    """Return which parts of a series are others than when it was read; empty for other recordings."""
    if not recording.parts or before is None:
        return ""
    was, is_now = ({name: of_file for name, *of_file in stat.files} for stat in (before, now))
    return names_text(
        [
            f"{name} {'is new' if name not in was else 'is gone' if name not in is_now else 'changed'}"
            for name in sorted(was.keys() | is_now.keys())
            if was.get(name) != is_now.get(name)
        ]
    )


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


@dataclass
class Planner:
    """Plans all recordings; examines only those that changed since they were last planned.

    Attributes:
        assets: the assets of a recording under the recipe.
        discovery: the recordings on disk.
        registered: the existing partition keys.
        project: fingerprint of the code, the recipe and the files that it names; None has all recordings examined.
        storage_ids: asset -> partition key -> id of Dagster's latest record.
        fetch: takes some of `storage_ids` and partition keys; returns partition key -> asset -> what Dagster recorded last.
        kept: states of recordings that are not planned again if their artifacts are unchanged.
        check: returns what quick checks find in a recording with nothing to do (`BagPlan.findings`), to be kept with its plan;
            None if one could not read what it checks.
        checked: how many artifacts are; see `PlanCache`.
    """

    assets: RecordingAssets
    discovery: Discovery
    registered: frozenset[str]
    project: str | None
    storage_ids: Mapping[str, Mapping[str, int]]
    fetch: Fetch
    kept: Mapping[str, BagPlan]
    check: Callable[[BagPlan], tuple[tuple[str, str, str], ...] | None]
    checked: Checked

    def __post_init__(self) -> None:
        self._artifacts = f"{self.assets.store.root}/artifacts"
        self._cache = PlanCache(self.assets.recipe.state, self._artifacts, self.checked)
        asked = self.discovery.recordings.keys() - self.kept.keys() if self.kept else None
        made = sum(len(bag.made) for bag in self.kept.values() if isinstance(bag, KeptPlan))
        self._before = self._cache.load(asked, made // SIZE)
        self.kept = {key: bag for key, bag in self.kept.items() if self._still_holds(bag)}
        self._unsettled = Unsettled(self.assets.recipe.state).noted()
        self._fingerprints = {} if self.project is None else self._current_fingerprints(self.project)
        # Of the recordings whose last plan may hold: that plan, and the fingerprint as it is now.
        self._last = {
            key: (self._before[key], now)
            for key, now in self._fingerprints.items()
            if key in self._before and key not in self._unsettled
        }

    @uncollected()
    def plan(self, on_planned: Callable[[int, int], None] | None = None) -> Plan:
        """Plan all recordings; nothing is changed but what the next plan remembers.

        Args:
            on_planned: called, where it takes long, with how many recordings have been examined, and how many will be.
        """
        recordings = self.discovery.recordings
        bags = {**self.kept, **self._unchanged()}
        unchanged = frozenset(bags)
        bags |= self._recorded_anew(key for key in recordings if key not in unchanged)
        changed = [key for key in recordings if key not in bags]
        recorded: dict[str, Mapping[str, Recorded]] = {}
        examined = 0
        for some in _batches(changed):
            records = self.fetch(self.storage_ids, [key for key in some if key in self.registered])
            for key in some:
                of_key = records.get(key, {})
                graph = recorded_graph(self.assets, recordings[key], of_key)
                bag = plan_recording(graph)
                bags[key] = self._as_kept(_once_more(bag) if key in self._unsettled else bag)
            recorded |= {key: of for key, of in records.items() if not bags[key].settled}
            examined += len(some)
            if on_planned is not None and len(changed) > AT_A_TIME:
                on_planned(examined, len(changed))
        new = {key: bag for key, bag in bags.items() if key not in unchanged and isinstance(bag, KeptPlan)}
        noted = {key: CachedPlan(self._fingerprints[key], bag.made, bag.row) for key, bag in new.items()}
        self._cache.save(noted, self._before.keys() - unchanged - new.keys())
        ordered = {key: bags[key] for key in recordings}
        found = self.discovery
        ties = Ties(found.near, found.former_keys)
        removed = found.removed(self.registered)
        asked = {**found.asked, **ties.disputed(self.assets.recipe.splits)}
        seen_from = found, self.registered, self.storage_ids, self.project
        return Plan(ordered, dict(found.excluded), removed, ties, asked, recorded, *seen_from)

    def _as_kept(self, bag: BagPlan) -> BagPlan:
        """Return the plan of a recording with nothing to do as the next one finds it, which is smaller; others as they are."""
        if not bag.settled or bag.key not in self._fingerprints:
            return bag
        # It will be planned again, and whoever needs what cannot be read reports that.
        with suppress(PlanNeeded, StoreError):
            looked_into = replace(bag, findings=self.check(bag), damage=damage_of(bag, self.assets.store))
            if looked_into.findings is not None:
                return KeptPlan(bag.key, looked_into.as_row(), note_of(self._artifacts, bag.artifacts))
        return bag

    def touched(self) -> dict[str, Recorded]:
        """Return the recordings of which only the time changed, as far as can be told without reading -> record of `bag`.

        They are those whose plan would say so (`BagPlan.touched`).
        """
        found = {}
        same = {
            key
            for key, (entry, now) in self._last.items()
            if (entry.fingerprint.files, entry.fingerprint.bag) == (now.files, now.bag)
        }
        changed = [
            key
            for key in self.discovery.recordings
            if key in self.registered and key not in self.kept and key not in same
        ]
        for some in _batches(changed):
            for key, records in self.fetch({"bag": self.storage_ids["bag"]}, some).items():
                recorded = records.get("bag")
                _, stat, state = _bag_state(self.discovery.recordings[key], recorded, self.assets.index)
                if recorded is not None and _is_touched(state, recorded, stat):
                    found[key] = recorded
        return found

    def _current_fingerprints(self, project: str) -> dict[str, RecordingFingerprint]:
        found = {}
        for key, recording in self.discovery.recordings.items():
            if key in self.kept:
                continue
            ids = {asset: keys[key] for asset, keys in self.storage_ids.items() if key in keys}
            found[key] = recording_fingerprint(
                project,
                recording.relative,
                recording.files,
                files_beside(self.assets.recipe, recording),
                ids if key in self.registered else {},
                recording.seen,
            )
        return found

    def _unchanged(self) -> dict[str, BagPlan]:
        """Return the last plans of the recordings that have not changed since."""
        last = self._last.items()
        alike = (KeptPlan(key, one.row, one.made) for key, (one, now) in last if one.fingerprint == now)
        return {bag.key: bag for bag in alike if self._still_holds(bag)}

    def _still_holds(self, bag: BagPlan) -> bool:
        """Return whether a plan's artifacts are unchanged, as far as they are checked; where there is something to do, nobody looks."""
        if not isinstance(bag, KeptPlan):
            return not bag.settled
        if not (holds := self._cache.holds(bag.made)):
            _remove_incomplete(self.assets.store, bag)
        return holds

    def _recorded_anew(self, keys: Iterable[str]) -> dict[str, BagPlan]:
        """Return the last plans of recordings that changed, but only in time, and `bag` is on record with the new one.

        Everything else rests on their content, and so has not changed.
        """
        found: dict[str, BagPlan] = {}
        alike = []
        for key in keys:
            if key in self._last:
                entry, now = self._last[key]
                if now.bag is not None and entry.fingerprint.rest == now.rest:
                    alike.append(key)
        for some in _batches(alike):
            for key, records in self.fetch({"bag": self.storage_ids["bag"]}, some).items():
                entry = self._before[key]
                last = KeptPlan(key, entry.row, entry.made)
                digest, _, state = _bag_state(
                    self.discovery.recordings[key], records.get("bag"), self.assets.index
                )
                is_same = state.state == "fresh" and digest == last.assets["bag"].data_version
                if is_same and self._cache.holds(last.made):
                    found[key] = last
        return found


def damage_of(bag: BagPlan, store: Store) -> str:
    """Return how much of a recording was read, if it is damaged, else ""; nothing is read of one whose plan was kept."""
    if bag.damage is not None:
        return bag.damage
    inventory = bag.current_artifact(store, INVENTORY.name)
    return "" if inventory is None else inventory.summary().get("damage", "")


def _batches(keys: list[str]) -> Iterator[list[str]]:
    """Yield the keys in batches, whose records are fetched at a time."""
    for start in range(0, len(keys), AT_A_TIME):
        yield keys[start : start + AT_A_TIME]


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
