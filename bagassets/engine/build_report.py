"""What a build is asked for, what it tells while it works, and what it came to."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from bagassets.engine.plan_model import Plan
from bagassets.engine.recording_assets import UPSTREAM

__all__ = ["DATASETS", "SELECTABLE", "BagOutcome", "BuildOptions", "BuildReport", "Event", "Result"]

Result = Literal["built", "hit", "fresh", "skipped", "failed", "stopped"]

# Dataset -> the asset of each recording that it is made from.
DATASETS = {"nuscenes_dataset": "nuscenes_tables", "vision_dataset": "vision_sequences"}
SELECTABLE = ("bag", *UPSTREAM, *DATASETS)


@dataclass(frozen=True)
class BuildOptions:
    """What is asked of a build.

    Attributes:
        jobs: recordings worked on at the same time.
        retry_failed: try again what failed before on the same input.
        bags: keys, globs or paths of the recordings to look at; none = all.
        select: assets to bring up to date, with what they read; None = all.
    """

    jobs: int = 1
    retry_failed: bool = False
    bags: tuple[str, ...] = ()
    select: frozenset[str] | None = None

    @property
    def is_whole(self) -> bool:
        """True if everything is asked for."""
        return not self.bags and self.select is None

    @property
    def recording_assets(self) -> frozenset[str] | None:
        """The assets of a recording that are asked for, with those that selected datasets need; None = all."""
        if self.select is None:
            return None
        return frozenset(DATASETS.get(asset, asset) for asset in self.select)

    def datasets(self, known: Iterable[str]) -> tuple[str, ...]:
        """Return those of the `known` datasets that are asked for."""
        return tuple(name for name in known if self.select is None or name in self.select)


@dataclass(frozen=True)
class Event:
    """Progress of a build.

    Attributes:
        kind: `planned` once, then `started`, `done`, `failed` or `stopped` of a recording, or of the
            dataset (key empty).
        key: partition key.
        message: why it failed, or what was planned.
        sizes: for `planned`, the recordings that need a run -> bytes.
    """

    kind: Literal["planned", "started", "done", "failed", "stopped"]
    key: str = ""
    message: str = ""
    sizes: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class BagOutcome:
    """What a build came to for one recording.

    Attributes:
        result: `built` (something ran), `hit` (the store knew all of it, Dagster's records were brought up to
            date), `fresh` (nothing to do), `skipped`, `failed`, or `stopped` before it was done.
        reason: why it was skipped, or failed.
        seconds: wall time of its run; 0 without one.
    """

    result: Result
    reason: str = ""
    seconds: float = 0.0


@dataclass
class BuildReport:
    """What a build came to.

    Attributes:
        plan: the state of everything after the build.
        outcomes: recording -> what happened to it.
        removed: recordings that were gone.
        dataset: `updated`, `fresh`, `failed`, `stopped`, or `not selected`.
        dataset_problem: why the dataset could not be made.
        dataset_path: its dataroot.
        interrupted: somebody stopped the build.
        seconds: wall time.
    """

    plan: Plan
    outcomes: dict[str, BagOutcome] = field(default_factory=dict)
    removed: tuple[str, ...] = ()
    dataset: str = "fresh"
    dataset_problem: str = ""
    dataset_path: Path = Path()
    interrupted: bool = False
    seconds: float = 0.0

    def having(self, *results: Result) -> dict[str, BagOutcome]:
        """Return the recordings with one of `results`."""
        return {key: outcome for key, outcome in self.outcomes.items() if outcome.result in results}

    @property
    def succeeded(self) -> bool:
        """True if nothing failed and nobody stopped it."""
        return not (self.interrupted or self.dataset_problem or self.having("failed", "stopped"))

    def counts(self) -> dict[str, int]:
        """Return result -> number of recordings."""
        results: tuple[Result, ...] = ("built", "hit", "fresh", "skipped", "failed", "stopped")
        return {result: len(self.having(result)) for result in results}

    def as_json(self) -> dict[str, Any]:
        """Return the report as JSON, without the plan."""
        return {
            "recordings": {
                key: {
                    "result": outcome.result,
                    "reason": outcome.reason,
                    "seconds": round(outcome.seconds, 3),
                }
                for key, outcome in self.outcomes.items()
            },
            "counts": self.counts(),
            "excluded": dict(self.plan.excluded),
            "removed": list(self.removed),
            "dataset": {
                "state": self.dataset,
                "path": str(self.dataset_path),
                "problem": self.dataset_problem,
            },
            "interrupted": self.interrupted,
            "seconds": round(self.seconds, 3),
        }
