"""The plan: the state of every asset of every recording, with the reason in words.

One function decides for the command line, the sensor and the status table alike. It reads
what Dagster has recorded, what the store knows and what lies on disk; it runs nothing.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from hashlib import sha256

from bagassets.bags.digest import DigestIndex, RecordingStat, stat_files, stored_digest
from bagassets.bags.discover import Discovery
from bagassets.bags.model import Found
from bagassets.engine.code_version import code_version
from bagassets.engine.differences import changes, in_words
from bagassets.engine.plan_model import (
    ALL_ASSETS,
    RECORDING_ASSETS,
    AssetState,
    BagPlan,
    Plan,
    Recorded,
    State,
    with_upstream,
)
from bagassets.engine.recording_assets import (
    UPSTREAM,
    AssetResult,
    BuildFailure,
    NotMadeError,
    Skipped,
    assets_of,
)
from bagassets.engine.recording_build import RecordingBuild
from bagassets.errors import BagAssetsError
from bagassets.recipe.model import Recipe
from bagassets.store.store import Store

__all__ = [
    "ALL_ASSETS",
    "RECORDING_ASSETS",
    "AssetState",
    "BagPlan",
    "Plan",
    "Planner",
    "Recorded",
    "State",
    "Walked",
    "make_plan",
    "with_upstream",
]


def make_plan(
    recipe: Recipe,
    store: Store,
    discovery: Discovery,
    recorded: Mapping[str, Mapping[str, Recorded]],
    registered: frozenset[str],
    index: DigestIndex | None = None,
) -> Plan:
    """Decide for all recordings.

    Args:
        recipe: the recipe.
        store: the artifact store.
        discovery: the recordings on disk.
        recorded: asset -> partition key -> what Dagster recorded last.
        registered: the live partition keys.
        index: our own index of digests of files.
    """
    planner = Planner(recipe, store, index)
    bags = {}
    for key, found in discovery.found.items():
        latest = {asset: records[key] for asset, records in recorded.items() if key in records}
        bags[key] = planner.plan(found, latest if key in registered else {})
    return Plan(bags, dict(discovery.excluded), discovery.removed(registered))


@dataclass
class Planner:
    """Decides for one recording after the other.

    Attributes:
        recipe: the recipe.
        store: the artifact store.
        index: our own index of digests of files.
    """

    recipe: Recipe
    store: Store
    index: DigestIndex | None = None
    assets: tuple[str, ...] = field(init=False)
    versions: Mapping[str, str] = field(init=False)

    def __post_init__(self) -> None:
        self.assets = assets_of(self.recipe)
        self.versions = {asset: code_version(self.recipe, asset) for asset in self.assets}

    def plan(self, found: Found, recorded: Mapping[str, Recorded]) -> BagPlan:
        """Return the states of one recording.

        Args:
            found: the recording.
            recorded: asset -> what Dagster recorded last; nothing if its partition is not alive.
        """
        digest, stat, bag_state = _bag_state(found, recorded.get("bag"), self.index)
        states = {"bag": bag_state}
        on_record = {asset: record.data_version for asset, record in recorded.items()}
        if digest is None:
            for asset in self.assets:
                state: State = "unknown" if asset in recorded else "missing"
                states[asset] = AssetState(state, f"waits for bag ({bag_state.reason})")
            return BagPlan(found.key, states, found.format, on_record)
        walk = _walk(RecordingBuild(self.recipe, self.store, found, digest, stat, dry=True))
        current = on_record | {"bag": digest}
        current |= {asset: result.artifact.digest for asset, result in walk.known.items()}
        for asset in self.assets:
            states[asset] = self._state(asset, walk, recorded.get(asset), current, states)
        return BagPlan(found.key, states, found.format, on_record, tuple(walk.channels()))

    def walk(self, found: Found, recorded: Mapping[str, Recorded]) -> "Walked":
        """Return what is known of the assets of one recording; nothing if its content is not known yet."""
        digest, stat, _ = _bag_state(found, recorded.get("bag"), self.index)
        if digest is None:
            return Walked()
        return _walk(RecordingBuild(self.recipe, self.store, found, digest, stat, dry=True))

    def _state(
        self,
        asset: str,
        walk: "Walked",
        recorded: Recorded | None,
        current: Mapping[str, str],
        states: Mapping[str, AssetState],
    ) -> AssetState:
        if asset in walk.known:
            return _known_state(walk.known[asset], recorded, self.versions[asset], current, states)
        if walk.skipped is not None:
            return AssetState("skipped", walk.skipped)
        err = walk.errors.get(asset)
        if isinstance(err, NotMadeError):
            return self._miss_state(err, recorded)
        if err is not None:
            return AssetState("failed", str(err))
        cause = next((name for name in UPSTREAM[asset] if name in states and _blocks(states[name])), None)
        if cause is None:
            cause = next((name for name in self.assets if name in walk.errors), "bag")
        reason = states[cause].reason if cause in states else ""
        # One chain of reasons, not one in another: "waits for frames (waits for calibration (…))" says less.
        return AssetState(
            "unknown", reason if reason.startswith("waits for") else f"waits for {cause} ({reason})"
        )

    def _miss_state(self, err: NotMadeError, recorded: Recorded | None) -> AssetState:
        if err.failure is not None:
            return AssetState("failed", err.failure)
        if recorded is None:
            return AssetState("missing", "never made")
        before = None if recorded.action is None else self.store.action(recorded.action)
        if before is None:
            return AssetState("stale", "the record of the action that made it is gone")
        if not err.channels:
            now = err.action.as_json()
            return AssetState(
                "stale", in_words(changes(before, now)) or "its artifact is gone from the store"
            )
        reasons = []
        actions = before["params"].get("actions", {})
        for channel, action in err.channels.items():
            old = self.store.action(actions[channel]) if channel in actions else None
            if old is None:
                reasons.append(f"{channel} is new")
            else:
                words = in_words(changes(old, action.as_json())) or "its artifact is gone from the store"
                reasons.append(f"{channel}: {words}")
        return AssetState("stale", "; ".join(reasons))


def _blocks(state: AssetState) -> bool:
    return state.state in {"stale", "unknown", "failed", "missing"}


def _bag_state(
    found: Found, recorded: Recorded | None, index: DigestIndex | None
) -> tuple[str | None, RecordingStat, AssetState]:
    stats = stat_files(found)
    stat = RecordingStat(tuple((path.name, s.st_size, s.st_mtime_ns) for path, s in stats))
    if recorded is not None and recorded.stat == stat:
        if index is None or not any(index.doubts(path, s) for path, s in stats):
            state = AssetState("fresh", "size and time unchanged", recorded.data_version)
            return recorded.data_version, stat, state
        why = "size and time unchanged, but the file was touched since"
    else:
        why = "size or time changed"
    digest = stored_digest(found, index)
    if recorded is None:
        return digest, stat, AssetState("missing", "new recording", digest)
    if digest == recorded.data_version:
        return digest, stat, AssetState("record-only", "touched, content unchanged", digest)
    reason = f"{why}: its content has to be read" if digest is None else "content changed"
    return digest, stat, AssetState("stale", reason, digest)


@dataclass
class Walked:
    """What a walk along the assets of one recording met.

    Attributes:
        known: asset -> its result in the store.
        errors: asset -> why it is not known: not made yet, or failed.
        skipped: why the recording takes no part, or None.
    """

    known: dict[str, AssetResult] = field(default_factory=dict)
    errors: Mapping[str, BagAssetsError] = field(default_factory=dict)
    skipped: str | None = None

    def channels(self) -> list[str]:
        """Return the artifacts of single channels."""
        return [digest for result in self.known.values() for digest in result.channels.values()]


def _walk(build: RecordingBuild) -> Walked:
    walked = Walked()
    try:
        for made in build.build():
            if isinstance(made, Skipped):
                walked.skipped = made.reason
            else:
                walked.known[made.asset] = made
    except BuildFailure as failure:
        walked.errors = failure.errors
    return walked


def _known_state(
    result: AssetResult,
    recorded: Recorded | None,
    version: str,
    current: Mapping[str, str],
    states: Mapping[str, AssetState],
) -> AssetState:
    digest = result.artifact.digest
    if recorded is None:
        return AssetState("record-only", "the store has it, Dagster has no record", digest)
    if recorded.data_version != digest:
        return AssetState("record-only", "the store has the result for the new inputs", digest)
    if recorded.code_version != version:
        return AssetState("record-only", "recipe or step version changed, the result did not", digest)
    for name, data_version in recorded.inputs.items():
        if name in current and _as_input(current[name]) != data_version:
            why = states[name].reason if name in states and states[name].state != "fresh" else "made anew"
            return AssetState("record-only", f"{name} changed ({why}), the result did not", digest)
    return AssetState("fresh", "up to date", digest)


def _as_input(data_version: str) -> str:
    """Return how Dagster notes the version of a partitioned input: a digest over its partitions, here one."""
    return sha256(data_version.encode()).hexdigest()
