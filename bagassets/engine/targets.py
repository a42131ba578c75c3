"""Targets: what is made from the assets of recordings (datasets, the map, users' own assets), and the state of each.

A target is compared with its record: the version of its code, and of everything that it reads. It waits for what it reads
if that is yet to be made, and is blocked if that failed or is never made.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Literal

from bagassets.engine.plan import AssetState, BagPlan, Recorded, version_as_input
from bagassets.store.canonical import digest_json

TO_MAKE = frozenset({"missing", "stale"})
NOTHING_TO_MAKE_IT_FROM = "never made, as no recording can be part of it yet"
_TO_COME = TO_MAKE | {"unknown", "record-only"}


@dataclass(frozen=True)
class Read:
    """Something that a target reads.

    Attributes:
        name: its asset key, as users write it.
        how: that of the `same` recording, those of `all` recordings, or the `whole` of an asset without partitions.
    """

    name: str
    how: Literal["same", "all", "whole"]


@dataclass(frozen=True)
class Target:
    """Something that is made from assets of recordings.

    Attributes:
        name: its asset key, as users write it.
        reads: what it reads, apart from itself.
        code_version: of what makes it; None if any will do.
        is_partitioned: there is one of each recording, else one of all.
        code_changed: why it is stale if the code version differs; "" for a sentence with both versions.
    """

    name: str
    reads: tuple[Read, ...]
    code_version: str | None
    is_partitioned: bool = False
    code_changed: str = ""


@dataclass(frozen=True)
class Evidence:
    """What is known of a target: of one recording, or as a whole.

    Attributes:
        now: what it would read -> version; "" for what was never made.
        recorded: its latest record.
        before: what it has read -> version, as Dagster recorded it, which it does for single partitions only.
        told: returns the `inputs_digest` that its run was given: "" if it was given none, None if the run is gone.
        is_whole: returns whether its files are as they were when it was made.
        failure: returns why making it from the same inputs failed, or "".
        changed: returns why it is stale if it reads something else than before; "" for "<name> changed".
        waits_for: results that it takes as soon as they are there, and is made without until then.
        is_due: False while there is nothing to make it from.
    """

    now: Mapping[str, str]
    recorded: Recorded | None
    before: Mapping[str, str] = field(default_factory=dict)
    told: Callable[[], str | None] = lambda: None
    is_whole: Callable[[], bool] = lambda: True
    failure: Callable[[], str] = lambda: ""
    changed: Callable[[], str] = lambda: ""
    waits_for: str = ""
    is_due: bool = True


def target_state(
    target: Target, found: Evidence, above: Iterable[tuple[Read, AssetState]] = ()
) -> AssetState:
    """Return the state of a target.

    Args:
        target: the target.
        found: what is known of it.
        above: state of whatever it reads that is brought up to date as well; the rest is taken as it is.
    """
    for read, state in above:
        if state.state in _TO_COME:
            return AssetState("unknown", f"{read.name} comes first")
        if state.state != "fresh" and read.how != "all":  # of all, those that are there are taken
            failed = AssetState("blocked", f"{read.name} failed")
            return failed if state.state == "failed" else AssetState(state.state, state.reason)
    recorded, waits, change = found.recorded, f"waits for {found.waits_for}", _change(target, found)
    if change is None and found.waits_for:
        return AssetState("unknown", waits)
    if change is None:
        if recorded is None:
            return AssetState("blocked", NOTHING_TO_MAKE_IT_FROM)
        return AssetState("fresh", "what it reads is as it was when it was made", recorded.data_version)
    if failure := found.failure():
        return AssetState("failed", failure)
    reason = f"{change}; {waits}" if found.waits_for else change
    return AssetState("missing" if recorded is None else "stale", reason)


def state_as_read(bag: BagPlan, asset: str, name: str) -> AssetState:
    """Return the state of an asset of a recording for targets that read it, by that name, with the first cause."""
    state = bag.assets[asset]
    if state.state in {"fresh", "skipped"} or bag.failed is None:
        return state
    what = "failed" if state.state == "failed" else "is not there"
    return AssetState("blocked", f"{name} {what}, as its recording failed")


def read_before(target: Target, found: Evidence) -> dict[str, str] | None:
    """Return what a target has read -> version, spelled as that of now where it is the same; None if it was never made."""
    if found.recorded is None:
        return None
    before = {}
    for read in target.reads:
        now, was = found.now[read.name], found.before.get(read.name, "")
        if read.how == "all":
            was = now if found.told() == inputs_digest(target, found.now) else ""
        before[read.name] = now if was in _spellings(now) else was
    return before


def inputs_digest(target: Target, reads: Mapping[str, str]) -> str:
    """Return the digest of what a target is made from: its code version, and what it reads -> version."""
    return digest_json({"code_version": target.code_version, "reads": dict(reads)})[:32]


def _change(target: Target, found: Evidence) -> str | None:
    """Return why a target has to be made, or None."""
    recorded = found.recorded
    if recorded is None:
        return "never made" if found.is_due else None
    if target.code_version is not None and recorded.code_version != target.code_version:
        versions = f"its code version is {target.code_version}, was {recorded.code_version}"
        return target.code_changed or versions
    for read in target.reads:
        if read.how != "all" and found.before.get(read.name, "") not in _spellings(found.now[read.name]):
            # A run of a build says it, too, so that nothing is made again and again if Dagster spells it differently.
            is_same = found.told() == inputs_digest(target, found.now)
            return None if is_same else found.changed() or f"{read.name} changed"
    if any(read.how == "all" for read in target.reads):
        told = found.told()
        if told == "":
            return "made by hand, so what it has read is not on record"
        if told not in {None, inputs_digest(target, found.now)}:
            return "a recording was added, changed or removed"
    return None if found.is_whole() else "its files are gone or were changed"


def _spellings(version: str) -> set[str]:
    """Return how a record spells the version of what was read: Dagster digests that of a partition."""
    return {version or "INITIAL", version, version_as_input(version)}
