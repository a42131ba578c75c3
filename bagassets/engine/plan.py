"""The plan: the state of every asset of every recording, with the reason in words.

One function decides for the command line, the sensor and the status table alike. It reads
what Dagster has recorded, what the store knows and what lies on disk; it runs nothing.
"""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from hashlib import sha256
from typing import Literal

from bagassets.bags.digest import DigestIndex, RecordingStat, recording_stat, stored_digest
from bagassets.bags.discover import Discovery
from bagassets.bags.model import Format, Found
from bagassets.engine.code_version import code_version
from bagassets.engine.recording_build import (
    ASSETS,
    UPSTREAM,
    AssetResult,
    BuildFailure,
    NotMadeError,
    RecordingBuild,
    Skipped,
)
from bagassets.errors import BagAssetsError
from bagassets.recipe.model import Recipe
from bagassets.store.store import Store

__all__ = [
    "RECORDING_ASSETS",
    "AssetState",
    "BagPlan",
    "Plan",
    "Recorded",
    "State",
    "make_plan",
    "with_upstream",
]

State = Literal["fresh", "record-only", "stale", "unknown", "failed", "missing", "skipped"]

RECORDING_ASSETS = ("bag", *ASSETS)


@dataclass(frozen=True)
class Recorded:
    """The latest materialization of one asset partition in Dagster's event log.

    Attributes:
        data_version: digest of the recording or of the artifact.
        code_version: step version and recipe fields it was made with.
        inputs: upstream asset -> data version that it was made from.
        stat: for `bag`, sizes and times of the files that its digest holds for.
        cached: nothing had to run for it; None if it does not say.
        action: digest of the action that made it.
        run_id: run that recorded it.
    """

    data_version: str
    code_version: str | None
    inputs: Mapping[str, str] = field(default_factory=dict)
    stat: RecordingStat | None = None
    cached: bool | None = None
    action: str | None = None
    run_id: str = ""


@dataclass(frozen=True)
class AssetState:
    """State of one asset of one recording.

    Attributes:
        state: see `docs/how-it-decides.md`.
        reason: why, in words.
        data_version: the artifact that is or would be current, where known.
    """

    state: State
    reason: str
    data_version: str | None = None


@dataclass(frozen=True)
class BagPlan:
    """States of all assets of one recording."""

    key: str
    assets: Mapping[str, AssetState]
    format: Format = "ros1"

    @property
    def skipped(self) -> str | None:
        """Why the recording takes no part, or None."""
        tables = self.assets["nuscenes_tables"]
        return tables.reason if tables.state == "skipped" else None

    @property
    def failed(self) -> str | None:
        """The sentence of the first asset that failed, or None."""
        return next((state.reason for state in self.assets.values() if state.state == "failed"), None)

    def to_run(self, *, retry_failed: bool = False, select: Collection[str] | None = None) -> tuple[str, ...]:
        """Return the assets that a run should materialize, in order; none if all is well.

        A run takes all assets, fresh ones too: those are hits, and Dagster's own markers agree afterwards.

        Args:
            retry_failed: try again what failed before on the same input.
            select: assets that matter; what they read comes along. None = all.
        """
        idle = {"fresh", "skipped"} | (set() if retry_failed else {"failed"})
        if self.failed is not None and not retry_failed:
            # What hangs on a failed asset is unknown for ever: nothing to gain from a run.
            idle.add("unknown")
        wanted = RECORDING_ASSETS if select is None else with_upstream(select)
        return wanted if any(self.assets[name].state not in idle for name in wanted) else ()


def with_upstream(assets: Iterable[str]) -> tuple[str, ...]:
    """Return `assets` (those of a recording among them) and everything that they read, in order."""
    wanted: set[str] = set()
    waiting = [asset for asset in assets if asset in RECORDING_ASSETS]
    while waiting:
        asset = waiting.pop()
        if asset not in wanted:
            wanted.add(asset)
            waiting += ["bag", *UPSTREAM[asset]] if asset != "bag" else []
    return tuple(name for name in RECORDING_ASSETS if name in wanted)


@dataclass(frozen=True)
class Plan:
    """The state of everything."""

    bags: Mapping[str, BagPlan]
    excluded: Mapping[str, str]
    removed: tuple[str, ...]


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
        index: digests of recordings whose file system has no extended attributes.
    """
    versions = {asset: code_version(recipe, asset) for asset in ASSETS}
    bags = {}
    for key, found in discovery.found.items():
        latest = {asset: records[key] for asset, records in recorded.items() if key in records}
        bags[key] = BagPlan(key, _states(recipe, store, found, latest, versions, index), found.format)
    removed = tuple(sorted(registered - discovery.found.keys()))
    return Plan(bags, dict(discovery.excluded), removed)


def _states(
    recipe: Recipe,
    store: Store,
    found: Found,
    recorded: Mapping[str, Recorded],
    versions: Mapping[str, str],
    index: DigestIndex | None,
) -> dict[str, AssetState]:
    digest, stat, bag_state = _bag_state(found, recorded.get("bag"), index)
    states = {"bag": bag_state}
    if digest is None:
        for asset in ASSETS:
            missing = asset not in recorded
            states[asset] = AssetState("missing" if missing else "unknown", bag_state.reason)
        return states
    known, misses, skipped = _walk(RecordingBuild(recipe, store, found, digest, stat, dry=True))
    current = {asset: record.data_version for asset, record in recorded.items()} | {"bag": digest}
    current |= {asset: result.artifact.digest for asset, result in known.items()}
    for asset in ASSETS:
        if asset in known:
            states[asset] = _known_state(known[asset], recorded.get(asset), versions[asset], current)
        elif skipped is not None:
            states[asset] = AssetState("skipped", skipped)
        elif isinstance(err := misses.get(asset), NotMadeError):
            states[asset] = _miss_state(err, asset in recorded)
        elif err is not None:
            states[asset] = AssetState("failed", str(err))
        else:
            cause = next((name for name in ASSETS if name in misses), "bag")
            states[asset] = AssetState("unknown", f"waits for {cause}")
    return states


def _bag_state(
    found: Found, recorded: Recorded | None, index: DigestIndex | None
) -> tuple[str | None, RecordingStat, AssetState]:
    stat = recording_stat(found)
    if recorded is not None and recorded.stat == stat:
        return (
            recorded.data_version,
            stat,
            AssetState("fresh", "size and time unchanged", recorded.data_version),
        )
    digest = stored_digest(found, index)
    if recorded is None:
        return digest, stat, AssetState("missing", "new recording", digest)
    if digest == recorded.data_version:
        return digest, stat, AssetState("record-only", "touched, content unchanged", digest)
    reason = "size or time changed" if digest is None else "content changed"
    return digest, stat, AssetState("stale", reason, digest)


def _walk(
    build: RecordingBuild,
) -> tuple[dict[str, AssetResult], dict[str, BagAssetsError], str | None]:
    known: dict[str, AssetResult] = {}
    try:
        for made in build.build():
            if isinstance(made, Skipped):
                return known, {}, made.reason
            known[made.asset] = made
    except BuildFailure as failure:
        return known, failure.errors, None
    return known, {}, None


def _known_state(
    result: AssetResult, recorded: Recorded | None, version: str, current: Mapping[str, str]
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
            return AssetState("record-only", f"{name} changed, the result did not", digest)
    return AssetState("fresh", "up to date", digest)


def _as_input(data_version: str) -> str:
    """Return how Dagster notes the version of a partitioned input: a digest over its partitions, here one."""
    return sha256(data_version.encode()).hexdigest()


def _miss_state(err: NotMadeError, was_made: bool) -> AssetState:
    if err.failure is not None:
        return AssetState("failed", err.failure)
    if was_made:
        return AssetState("stale", "inputs, recipe fields or step version changed")
    return AssetState("missing", "never made")
