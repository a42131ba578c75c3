"""The plan: the state of every asset of every recording."""

import json
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from hashlib import sha256
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from bagassets.base.json_types import JsonObject
from bagassets.engine.freshness.artifacts import digests_in
from bagassets.engine.splits import Ties
from bagassets.recordings.digest import RecordingStat
from bagassets.recordings.discover import Discovery
from bagassets.recordings.model import Format

if TYPE_CHECKING:
    from bagassets.store.artifact import Artifact
    from bagassets.store.store import Store

State = Literal["fresh", "record-only", "stale", "unknown", "blocked", "failed", "missing", "skipped"]
_SKIPPED, _AS_RECORDED = "skipped:", "="


@dataclass(frozen=True)
class Recorded:
    """The latest materialization of one asset partition in Dagster's event log.

    Attributes:
        data_version: digest of the recording or of the artifact; see `skip_version` for one that was skipped.
        code_version: Dagster's code version, from step version and recipe fields.
        inputs: upstream asset -> data version that it was made from.
        stat: for `bag`, sizes and times of the files when the digest was taken.
        cached: True if nothing had to run; None if that is not recorded.
        action: digest of the action that made it.
        run_id: the run that recorded it.
        made_along: for `bag`, the action of the inventory if the same pass has run it.
        content: for what was made from `bag`, the digest of the recording; "" if that is not recorded, and something else if
            it was made from assets of several contents.
        why_skipped: why there is no artifact, if it was skipped.
    """

    data_version: str
    code_version: str | None
    inputs: Mapping[str, str] = field(default_factory=dict)
    stat: RecordingStat | None = None
    cached: bool | None = None
    action: str | None = None
    run_id: str = ""
    made_along: str = ""
    content: str = ""
    why_skipped: str = ""

    @property
    def is_skip(self) -> bool:
        """True if there is no artifact, since the recording took no part."""
        return is_skip(self.data_version)


class AssetState(NamedTuple):
    """State of one asset of one recording (there may be 100,000 of them), or of a target (see `bagassets.engine.targets`).

    Attributes:
        state: see `docs/how-it-decides.md`.
        reason: a text that says why, back to the first cause.
        data_version: digest of the artifact that is or would be current, if known.
        is_final: it failed for a reason that is known without running it, so trying again would not help.
        to_record: it is skipped, and Dagster's record says something else, or there is none.
    """

    state: State
    reason: str
    data_version: str | None = None
    is_final: bool = False
    to_record: bool = False

    @property
    def is_settled(self) -> bool:
        """True if nothing is to be done about it, and it has not failed."""
        return self.state in {"fresh", "skipped"} and not self.to_record

    def as_json(self) -> JsonObject:
        """Return the state as JSON."""
        return {"state": self.state, "reason": self.reason, "data_version": self.data_version}


@dataclass(frozen=True)
class BagPlan:
    """States of all assets of one recording.

    Attributes:
        key: partition key.
        assets: asset -> its state.
        format: of the recording.
        recorded: asset -> data version that Dagster recorded last; without those that were skipped.
        channels: digests of the single channels' artifacts in frames and sweeps.
        optional: assets on which no dataset but their own depends.
        rig: name of the rig that made the recording; "" if none did.
        touched: its files have the names and sizes on record, but another time; whether their content is the same is
            not known, or it is known to be. So a settled recording is never one.
        outdated: assets whose record is of other content than the record of `bag`; none if it is settled.
        findings: severity, check and problem of what quick checks found in it; None if they have not been run.
        damage: how much of it was read, if it is damaged, else ""; None if nobody has looked.
    """

    key: str
    assets: Mapping[str, AssetState]
    format: Format = "ros1"
    recorded: Mapping[str, str] = field(default_factory=dict)
    channels: tuple[str, ...] = ()
    optional: frozenset[str] = frozenset()
    rig: str = ""
    touched: bool = False
    outdated: frozenset[str] = frozenset()
    findings: tuple[tuple[str, str, str], ...] | None = field(default=None, compare=False)
    damage: str | None = field(default=None, compare=False)

    @property
    def names(self) -> Collection[str]:
        """The names of its assets."""
        return self.assets

    @property
    def skipped(self) -> str | None:
        """Why the recording is skipped, or None."""
        return next((state.reason for state in self.assets.values() if state.state == "skipped"), None)

    @property
    def failed(self) -> str | None:
        """Why the first failed asset failed, or None."""
        return next((state.reason for state in self.assets.values() if state.state == "failed"), None)

    @property
    def can_be_retried(self) -> bool:
        """True if the first failed asset failed when it ran, so that it may succeed another time."""
        return not next((state.is_final for state in self.assets.values() if state.state == "failed"), True)

    @property
    def unusable(self) -> str | None:
        """Why the recording cannot be part of the nuScenes dataset, or None; optional assets do not matter."""
        needed = (state for name, state in self.assets.items() if name not in self.optional)
        return next((state.reason for state in needed if state.state == "failed"), None)

    @property
    def settled(self) -> bool:
        """True if nothing is to be done and nothing failed."""
        return all(state.is_settled for state in self.assets.values())

    @property
    def artifacts(self) -> tuple[str, ...]:
        """Digests of the artifacts that the states rest on, if there is nothing to do."""
        assets = (state.data_version for name, state in self.assets.items() if name != "bag")
        return tuple(digest for digest in (*assets, *self.channels) if digest is not None)

    def version(self, asset: str) -> str | None:
        """Return the data version that Dagster recorded last of an asset; None if there is none."""
        return self.recorded.get(asset)

    def to_run(self, *, retry_failed: bool = False, select: Collection[str] | None = None) -> tuple[str, ...]:
        """Return the assets that a run should materialize, in order; none if everything is up to date.

        A run covers all assets, fresh ones too: those are hits, and Dagster's own markers agree afterwards.

        Args:
            retry_failed: retry what failed before on the same input.
            select: assets that matter, with those that they read (see `RecordingAssets.with_upstream`). None = all.
        """
        if self.settled:
            return ()
        idle = {"fresh", "skipped"} | (set() if retry_failed else {"failed"})
        if self.failed is not None and not retry_failed:
            # What depends on a failed asset stays unknown: a run would gain nothing.
            idle.add("unknown")
        wanted = tuple(self.assets)
        if select is not None:
            wanted = tuple(name for name in wanted if name in select)
        states = [self.assets[name] for name in wanted]
        return wanted if any(one.state not in idle or one.to_record for one in states) else ()

    def current_artifact(self, store: "Store", asset: str) -> "Artifact | None":
        """Return the current artifact of an asset, else the last recorded one, if the store still has it."""
        state = self.assets.get(asset)
        for digest in (state.data_version if state else None, self.recorded.get(asset)):
            if digest and store.has(digest):
                return store.artifact(digest)
        return None

    def as_json(self) -> JsonObject:
        """Return the states as JSON."""
        return {name: state.as_json() for name, state in self.assets.items()}

    def as_row(self) -> bytes:
        """Return a settled plan without its key as lines of JSON: what is asked of 100,000 at a time, and the rest."""
        states = dict(self.assets)
        for name, state in self.assets.items():
            if state.data_version == self.recorded.get(name, ""):
                states[name] = state._replace(data_version=_AS_RECORDED)
        rest = [states, self.format, sorted(self.optional), self.rig]  # alike for most recordings
        lines = [self.skipped, [*self.assets], self.recorded, self.damage, self.findings, self.channels, rest]
        return b"\n".join(json.dumps(one, separators=(",", ":")).encode() for one in lines)

    @classmethod
    def from_row(cls, key: str, row: bytes) -> "BagPlan":
        """Inverse of `as_row`."""
        *lines, rest = row.split(b"\n")
        _, _, recorded, damage, found, channels = map(json.loads, lines)
        states, file_format, optional, rig = _value(rest)
        assets = {name: AssetState(*state) for name, state in states.items()}
        for name, state in assets.items():
            if state.data_version == _AS_RECORDED:
                assets[name] = state._replace(data_version=recorded[name])
        findings = None if found is None else tuple(map(tuple, found))
        facts = file_format, recorded, tuple(channels), frozenset(optional), rig
        return BagPlan(key, assets, *facts, findings=findings, damage=damage)


def _line(number: int) -> Any:  # noqa: ANN401  (of whatever type)
    return property(lambda kept: _value(kept.row.split(b"\n", number + 1)[number]))


@lru_cache(maxsize=64)  # but for what is recorded, most recordings have the same
def _value(line: bytes) -> Any:  # noqa: ANN401  (likewise)
    return json.loads(line.decode())


def _of_rest(name: str) -> Any:  # noqa: ANN401  (likewise)
    return property(lambda kept: getattr(_decoded(kept.key, kept.row), name))


@lru_cache(maxsize=8)  # whoever asks for more asks again
def _decoded(key: str, row: bytes) -> BagPlan:
    return BagPlan.from_row(key, row)


class KeptPlan(BagPlan):
    """A settled plan as it was kept, decoded each time that it is asked for more than that: nobody asks most of them.

    Args:
        key: partition key.
        row: see `BagPlan.as_row`.
        made: what is noted of its artifacts; see `CachedPlan`.
    """

    row: bytes
    made: bytes
    skipped, names, recorded, damage = map(_line, range(4))
    assets, format, channels, optional, rig = map(
        _of_rest, ("assets", "format", "channels", "optional", "rig")
    )
    failed = unusable = None
    settled, can_be_retried = True, False

    def __init__(self, key: str, row: bytes, made: bytes) -> None:
        vars(self).update(key=key, row=row, made=made)

    __hash__ = None  # type: ignore[assignment]  # as that of a plan, which has mappings

    def __eq__(self, other: object) -> bool:
        """Compare as the plans that they are."""
        plan = BagPlan.from_row(self.key, self.row)
        return plan == (BagPlan.from_row(other.key, other.row) if isinstance(other, KeptPlan) else other)

    def version(self, asset: str) -> str | None:
        """See `BagPlan`; a dataset asks for two of a dozen, of each recording, so only these are decoded."""
        mark = f'"{asset}":"'.encode()  # nowhere else in a row, as quotes within texts are escaped
        at = self.row.find(mark) + len(mark)
        return self.row[at : self.row.index(b'"', at)].decode() if at >= len(mark) else None

    @property
    def findings(self) -> tuple[tuple[str, str, str], ...] | None:
        """See `BagPlan`."""
        found = _value(self.row.split(b"\n", 5)[4])
        return None if found is None else tuple(map(tuple, found))

    @property
    def artifacts(self) -> tuple[str, ...]:
        """See `BagPlan`."""
        return tuple(digests_in(self.made))


@dataclass(frozen=True)
class Plan:
    """The state of everything, and what it was seen from.

    Attributes:
        bags: partition key -> states of the recording.
        excluded: path below the bag root -> why the globs leave it out.
        removed: registered partition keys whose recordings are gone, except those in folders that cannot be read.
        ties: which recordings lie in one split, and what the parts of series were called.
        asked: path of a whole drive -> what the user is to say about its parts.
        recorded: partition key -> asset -> latest record in Dagster, for the recordings that are not settled.
        discovery: the recordings on disk.
        live: the registered partition keys.
        storage_ids: asset -> partition key -> storage id of the latest record.
        project: see `Planner`.
    """

    bags: Mapping[str, BagPlan]
    excluded: Mapping[str, str]
    removed: tuple[str, ...]
    ties: Ties = field(default_factory=Ties)
    asked: Mapping[str, str] = field(default_factory=dict)
    recorded: Mapping[str, Mapping[str, Recorded]] = field(default_factory=dict, compare=False)
    discovery: Discovery = field(default_factory=lambda: Discovery({}, []), compare=False)
    live: frozenset[str] = field(default=frozenset(), compare=False)
    storage_ids: Mapping[str, Mapping[str, int]] = field(default_factory=dict, compare=False)
    project: str | None = field(default=None, compare=False)

    @property
    def joined(self) -> dict[str, list[str]]:
        """Series -> those of `removed` that have become its parts."""
        removed = frozenset(self.removed)
        found = {whole: [key for key in parts if key in removed] for whole, parts in self.ties.former.items()}
        return {whole: keys for whole, keys in found.items() if keys}

    @property
    def gone(self) -> tuple[str, ...]:
        """Those of `removed` that have become parts of nothing."""
        joined = {key for keys in self.joined.values() for key in keys}
        return tuple(key for key in self.removed if key not in joined)


def skip_version(reason: str) -> str:
    """Return the data version of an asset of a recording that takes no part, which is no digest of an artifact.

    It differs if the reason does, so what was recorded for another reason is recorded again.
    """
    return _SKIPPED + sha256(reason.encode()).hexdigest()


def is_skip(data_version: str) -> bool:
    """Return whether a data version is of `skip_version`; all others of assets of recordings are of artifacts."""
    return data_version.startswith(_SKIPPED)


def version_as_input(data_version: str) -> str:
    """Return how Dagster records the version of a partitioned input: a digest over its partitions, here a single one."""
    return sha256(data_version.encode()).hexdigest()
