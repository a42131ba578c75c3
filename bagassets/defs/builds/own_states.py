"""The state of the user's own assets, and why.

One of a recording is stale if it was never made, if its code version differs, or if something that it reads has another
version than its record says. One for all recordings says what it read in a tag of its run, since Dagster records that
only for few partitions.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import dagster as dg

from bagassets.base.json_types import JsonObject
from bagassets.defs.builds.pending_work import PendingWork
from bagassets.defs.graph.own_assets import OwnAsset, Read, Versions, inputs_digest, inputs_tag, told_inputs
from bagassets.defs.graph.own_location import code_digest
from bagassets.defs.records.events import fetch_recorded, latest_ids, recorded_whole, runs_of
from bagassets.defs.records.naming import DATASET_INPUTS
from bagassets.defs.records.partitions import PARTITION_TAG
from bagassets.defs.runs.execution import failure_of
from bagassets.engine.build_report import BuildOptions
from bagassets.engine.plan import BagPlan, Recorded, version_as_input

if TYPE_CHECKING:
    from bagassets.defs.builds.own_build import OwnProject

__all__ = ["OwnState", "OwnStates", "Survey"]

State = Literal["fresh", "missing", "stale", "unknown", "blocked", "skipped", "failed"]
_TO_COME = frozenset({"missing", "stale", "unknown"})


@dataclass(frozen=True)
class OwnState:
    """State of an asset, of one recording or as a whole.

    Attributes:
        state: `fresh`; `missing` or `stale`: to be made; `unknown`: something that it reads comes first; `blocked`: that
            failed, or is never made by a build; `skipped`: so is its recording; `failed` on the same inputs.
        reason: why.
        reads: what it would read -> version.
        recorded: what its record says it has read -> version, if it has one.
    """

    state: State
    reason: str
    reads: Mapping[str, str]
    recorded: Mapping[str, str] | None = None

    def as_json(self) -> JsonObject:
        """Return state and reason."""
        return {"state": self.state, "reason": self.reason}


OwnStates = Mapping[str, Mapping[str, OwnState]]
"""Asset -> partition key, "" for one without partitions -> state."""


class Survey:
    """The state of each asset, for the chosen recordings.

    Args:
        instance: where materializations are recorded.
        project: the user's assets; those that are not wanted, and are read by others, are taken as they are.
        pending: the state of our assets.
        options: `retry_failed` takes what failed on the same inputs as to be made.
        is_dataset_current: the datasets on disk are up to date; default: so they are, and stay so in a build.

    Attributes:
        states: what it found.
    """

    def __init__(
        self,
        instance: dg.DagsterInstance,
        project: "OwnProject",
        pending: PendingWork,
        options: BuildOptions,
        is_dataset_current: bool | None,
    ) -> None:
        stays = not (pending.behind or pending.todo or pending.plan.removed)
        self._is_dataset_current = stays if is_dataset_current is None else is_dataset_current
        self._instance, self._project, self._pending = instance, project, pending
        self._names, self._retry_failed = project.workspace.names, options.retry_failed
        self._versions = Versions(instance, self._names)
        self._code = code_digest()
        self.states: dict[str, dict[str, OwnState]] = {}
        recordings = sorted(pending.chosen & pending.plan.bags.keys())
        for name, asset in project.assets.items():  # each after those that it reads
            partitions = recordings if asset.is_partitioned else [""]
            recorded = self._recorded(asset, partitions)
            runs = self._runs(asset, recorded)
            self.states[name] = {
                partition: self._state(asset, partition, recorded.get(partition), runs)
                for partition in partitions
            }

    def _recorded(self, asset: OwnAsset, partitions: Collection[str]) -> dict[str, Recorded]:
        if asset.is_partitioned:
            ids = latest_ids(self._instance, self._names, [asset.key])
            found = fetch_recorded(self._instance, self._names, ids, partitions)
            return {key: made[asset.key] for key, made in found.items() if asset.key in made}
        newest = recorded_whole(self._instance, self._names, asset.key)
        return {} if newest is None else {"": newest}

    def _runs(self, asset: OwnAsset, recorded: Mapping[str, Recorded]) -> dict[str, str]:
        """Return run -> digest of what it read, for assets that read more than Dagster records."""
        if all(read.how != "all" for read in asset.reads):
            return {}
        runs = runs_of(self._instance, {one.run_id for one in recorded.values()})
        return {run.run_id: told_inputs(run, asset.key) for run in runs}

    def _state(
        self, asset: OwnAsset, partition: str, recorded: Recorded | None, runs: Mapping[str, str]
    ) -> OwnState:
        reads = self._versions.read_by(asset, partition)
        before = None if recorded is None else self._read_before(asset, reads, recorded, runs)
        for read in asset.reads:
            held = self._held_by(read, partition)
            if held is not None:
                return OwnState(held[0], held[1], reads, before)
        reason = self._change(asset, reads, recorded, runs)
        if reason is None:
            return OwnState("fresh", "what it reads is as it was when it was made", reads, before)
        state: State = "missing" if recorded is None else "stale"
        if not self._retry_failed and (failure := self._failure(asset, partition, reads)) is not None:
            state, reason = "failed", failure
        return OwnState(state, reason, reads, before)

    def _held_by(self, read: Read, partition: str) -> tuple[State, str] | None:
        """Return why an asset cannot be made yet, or ever: something that it reads is not up to date."""
        name = read.key.to_user_string()
        ours = self._names.asset_of(read.key)
        if name in self._project.assets:
            if name not in self._project.wanted:
                version = self._versions.of(read, partition)
                return ("blocked", f"{name} was never made") if version is None else None
            states = self.states[name]
            if read.how == "all":
                waits = any(one.state in _TO_COME for one in states.values())
                return ("unknown", f"{name} comes first") if waits else None
            state = states[partition if read.how == "same" else ""]
            if state.state in _TO_COME:
                return "unknown", f"{name} comes first"
            if state.state == "skipped":
                return "skipped", state.reason
            if state.state == "fresh":
                return None
            return "blocked", f"{name} failed" if state.state == "failed" else state.reason  # the first cause
        if read.how == "whole":
            is_behind = ours in {DATASET_INPUTS, *self._pending.datasets} and not self._is_dataset_current
            return ("unknown", f"{name} comes first") if is_behind else None
        bags = self._pending.plan.bags
        if ours is None or not any(ours in bag.assets for bag in bags.values()):
            return None  # neither ours nor the user's: it is taken as it is
        if read.how == "same":
            return _held_by_ours(bags[partition], ours, name)
        waits = any(
            (held := _held_by_ours(bag, ours, name)) and held[0] == "unknown" for bag in bags.values()
        )
        return ("unknown", f"{name} comes first") if waits else None

    def _change(
        self, asset: OwnAsset, reads: Mapping[str, str], recorded: Recorded | None, runs: Mapping[str, str]
    ) -> str | None:
        """Return why an asset has to be made, or None."""
        if recorded is None:
            return "never made"
        if asset.code_version is not None and recorded.code_version != asset.code_version:
            return f"its code version is {asset.code_version}, was {recorded.code_version}"
        for read in asset.reads:
            name = read.key.to_user_string()
            spelled = self._names.asset_of(read.key) or name
            if read.how != "all" and recorded.inputs.get(spelled, "") not in _spellings(reads[name]):
                # A run of a build says it, too, so that nothing is made again and again if Dagster spells it differently.
                run = self._instance.get_run_by_id(recorded.run_id)
                is_same = run is not None and told_inputs(run, asset.key) == inputs_digest(asset, reads)
                return None if is_same else f"{name} changed"
        told = runs.get(recorded.run_id)
        if told is None:
            return None
        if not told:
            return "made by hand, so what it has read is not on record"
        return None if told == inputs_digest(asset, reads) else "a recording was added, changed or removed"

    def _read_before(
        self, asset: OwnAsset, reads: Mapping[str, str], recorded: Recorded, runs: Mapping[str, str]
    ) -> dict[str, str]:
        """Return what an asset has read -> version, spelled as that of now where it is the same."""
        before = {}
        for read in asset.reads:
            name = read.key.to_user_string()
            version = recorded.inputs.get(self._names.asset_of(read.key) or name, "")
            if read.how == "all":
                is_same = runs.get(recorded.run_id) == inputs_digest(asset, reads)
                version = reads[name] if is_same else ""
            before[name] = reads[name] if version in _spellings(reads[name]) else version
        return before

    def _failure(self, asset: OwnAsset, partition: str, reads: Mapping[str, str]) -> str | None:
        """Return why the last run with the same inputs failed, or None if it did not."""
        tags = inputs_tag(asset, reads, self._code) | ({PARTITION_TAG: partition} if partition else {})
        last = self._instance.get_runs(dg.RunsFilter(tags=tags), limit=1)
        if not last or last[0].status != dg.DagsterRunStatus.FAILURE:
            return None
        return failure_of(self._instance, last[0]) or f"run {last[0].run_id} failed"


def _held_by_ours(bag: BagPlan, ours: str, name: str) -> tuple[State, str] | None:
    """Return why something that reads an asset of a recording cannot be made yet, or ever."""
    state = bag.assets[ours].state
    if state == "fresh":
        return None
    if state == "skipped":
        return "skipped", bag.assets[ours].reason
    if bag.failed is not None:
        return (
            "blocked",
            f"{name} {'failed' if state == 'failed' else 'is not there'}, as its recording failed",
        )
    return "unknown", f"{name} comes first"


def _spellings(version: str) -> set[str]:
    """Return how a record spells the version of what it has read: Dagster digests that of a partition."""
    return {version or "INITIAL", version, version_as_input(version)}
