"""What is to be done next: the policy of `bagassets build` and of the sensor, as one function of what is known.

Both are loops around it: look, decide, do. It reads nothing and knows no clock; times are in the state.
"""

import math
import sys
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from bagassets.engine.batches import DATASET, WORTH_STEPS_BYTES, Batch, batches, without_steps


class Work(NamedTuple):
    """What is to be made of a recording, or of the datasets, and what was done about just that so far.

    Attributes:
        assets: what a run would make.
        size: of the recording in bytes.
        is_new: nothing was ever made of it.
        is_touched: only the time of its files has changed (`BagPlan.touched`).
        tries: how often just this was asked for.
        tried_s: when it was last (Unix seconds).
        what: a digest by which it is recognized.
        why: a text that says why it is to be made.
    """

    assets: tuple[str, ...]
    size: int = 0
    is_new: bool = False
    is_touched: bool = False
    tries: int = 0
    tried_s: float = 0.0
    what: str = ""
    why: str = ""


@dataclass(frozen=True)
class Rules:
    """In what those who ask differ, and the numbers of their launcher.

    Attributes:
        jobs: runs that are at work at the same time.
        most_per_run: most small recordings that share a run, where runs wait in a queue; None: as `jobs` has it.
        most_runs: most runs that have not ended.
        most_tries: how often the same is asked for: a run may fail for a reason that the plan does not know.
        retry_s: pause before the second try; the one before the third is twice as long.
        patience_s: so long the datasets wait for runs, and nothing is removed if all recordings are gone at once.
        fewest_doubted: so many recordings must be gone for that.
        bag_first: of a recording that was only touched, `bag` alone is asked for.
    """

    jobs: int = 1
    most_per_run: int | None = None
    most_runs: int = sys.maxsize
    most_tries: int = 1
    retry_s: float = 0.0
    patience_s: float = math.inf
    fewest_doubted: int = 1
    bag_first: bool = False


@dataclass(frozen=True)
class State:
    """What is known of a project: what has changed, and sums over the rest.

    Attributes:
        now_s: the time (Unix seconds).
        found: number of recordings on disk.
        gone: registered recordings that are not on disk.
        held: those of `gone` that must stay registered for now -> why.
        new: recordings on disk that are not registered, and are no longer written to.
        todo: what is to be made, of recordings that are no longer written to; of `DATASET`, if some dataset is behind.
        joined: the datasets that a run makes, too, if it is the only one.
        active: what runs that have not ended are about; recordings, and `DATASET`.
        runs: number of these runs.
        empty_since_s: since when there has been no recording where there were some, as `Steps` said last.
        busy_since_s: since when there have been runs without a pause, likewise.
    """

    now_s: float = 0.0
    found: int = 0
    gone: Collection[str] = ()
    held: Mapping[str, str] = field(default_factory=dict)
    new: Collection[str] = ()
    todo: Mapping[str, Work] = field(default_factory=dict)
    joined: tuple[str, ...] = ()
    active: Collection[str] = ()
    runs: int = 0
    empty_since_s: float | None = None
    busy_since_s: float | None = None


@dataclass(frozen=True)
class Steps:
    """What is to be done next.

    Attributes:
        remove: recordings whose partitions are to be deleted.
        register: recordings that are to have one.
        runs: runs to be launched; the key of datasets is `DATASET`.
        without_steps: recordings that do without a step for each asset.
        is_over: no run is active or asked for, or for so long that the datasets wait no more.
        doubted_s: all recordings are gone at once: is their disk? For so many seconds nothing is done; else None.
        empty_since_s: see `State`.
        busy_since_s: likewise.
    """

    remove: tuple[str, ...] = ()
    register: tuple[str, ...] = ()
    runs: tuple[Batch, ...] = ()
    without_steps: frozenset[str] = frozenset()
    is_over: bool = False
    doubted_s: float | None = None
    empty_since_s: float | None = None
    busy_since_s: float | None = None


def next_steps(state: State, rules: Rules) -> Steps:
    """Return what is to be done next."""
    empty_since_s = None
    if not state.found and len(state.gone) >= rules.fewest_doubted:
        empty_since_s = state.empty_since_s or state.now_s
        left_s = rules.patience_s - (state.now_s - empty_since_s)
        if left_s > 0:
            return Steps(doubted_s=left_s, empty_since_s=empty_since_s)
    todo = {key: work for key, work in state.todo.items() if _may_ask(key, work, state, rules)}
    datasets = todo.pop(DATASET, None)
    sizes = {key: work.size for key, work in todo.items()}
    assets = {
        key: ("bag",) if work.is_touched and rules.bag_first else work.assets for key, work in todo.items()
    }
    dealt = batches(assets, sizes, rules.jobs, rules.most_per_run)
    runs = dealt[: max(0, rules.most_runs - state.runs)]
    is_busy = bool(runs or state.active)
    busy_since_s = (state.busy_since_s or state.now_s) if is_busy else None
    is_over = busy_since_s is None or state.now_s - busy_since_s > rules.patience_s
    if is_over and datasets is not None:
        runs = [*runs, {DATASET: datasets.assets}]
    elif state.joined and len(runs) == 1 and not state.active and _is_quick(runs[0], todo):
        runs = [{**runs[0], DATASET: state.joined}]
    return Steps(
        remove=tuple(sorted(frozenset(state.gone) - frozenset(state.held))),
        register=tuple(sorted(state.new)),
        runs=tuple(runs),
        without_steps=without_steps(sizes, rules.jobs, rules.most_per_run),
        is_over=is_over,
        empty_since_s=empty_since_s,
        busy_since_s=None if is_over else busy_since_s,
    )


def _may_ask(key: str, work: Work, state: State, rules: Rules) -> bool:
    """Return whether a run may be asked for: nobody is at it, and the same was not asked for just now, or too often."""
    if key in state.active or work.tries >= rules.most_tries:
        return False
    return not work.tries or state.now_s - work.tried_s >= rules.retry_s * work.tries


def _is_quick(run: Batch, todo: Mapping[str, Work]) -> bool:
    """Return whether a second run, for the datasets, would take a good part of the time that a first one takes.

    So it is unless a recording is very large, and new: else little is to be made again. There a step for each asset shows
    more in the web UI.
    """
    return all(todo[key].size <= WORTH_STEPS_BYTES or not todo[key].is_new for key in run)
