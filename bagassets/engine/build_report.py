"""What a build is asked for, what it tells while it works, and what it came to."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self

if TYPE_CHECKING:
    # Not imported: the command line, which waits while the server works, would pay for all of it.
    from bagassets.engine.plan_model import Plan

__all__ = ["BagOutcome", "BuildOptions", "BuildReport", "Event", "Result"]

Result = Literal["built", "hit", "fresh", "skipped", "failed", "stopped"]


@dataclass(frozen=True)
class BuildOptions:
    """What is asked of a build.

    Attributes:
        jobs: recordings worked on at the same time.
        retry_failed: try again what failed before on the same input.
        bags: keys, globs or paths of the recordings to look at; none = all.
        select: assets to bring up to date, with what they read; none = all.
    """

    jobs: int = 1
    retry_failed: bool = False
    bags: tuple[str, ...] = ()
    select: tuple[str, ...] = ()

    @property
    def is_whole(self) -> bool:
        """True if everything is asked for."""
        return not self.bags and not self.select

    def as_json(self) -> dict[str, Any]:
        """Return the options as JSON."""
        return asdict(self)

    @classmethod
    def from_json(cls, value: dict[str, Any]) -> Self:
        """Return what `as_json` gave."""
        return cls(value["jobs"], value["retry_failed"], tuple(value["bags"]), tuple(value["select"]))


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

    def as_json(self) -> dict[str, Any]:
        """Return the event as JSON."""
        return asdict(self)


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
        plan: the state of everything after the build; None in a report that another process made.
        outcomes: recording -> what happened to it.
        excluded: path below the bag root -> why it is no recording of the recipe's.
        removed: recordings that were gone.
        dataset: `updated`, `fresh`, `failed`, `stopped`, or `not selected`.
        dataset_problem: why the dataset could not be made.
        dataset_path: its dataroot.
        interrupted: somebody stopped the build.
        seconds: wall time.
    """

    plan: "Plan | None" = None
    outcomes: dict[str, BagOutcome] = field(default_factory=dict)
    excluded: Mapping[str, str] = field(default_factory=dict)
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
            "excluded": dict(self.excluded),
            "removed": list(self.removed),
            "dataset": {
                "state": self.dataset,
                "path": str(self.dataset_path),
                "problem": self.dataset_problem,
            },
            "interrupted": self.interrupted,
            "seconds": round(self.seconds, 3),
        }

    @classmethod
    def from_json(cls, value: dict[str, Any]) -> Self:
        """Return what `as_json` gave."""
        return cls(
            outcomes={
                key: BagOutcome(bag["result"], bag["reason"], bag["seconds"])
                for key, bag in value["recordings"].items()
            },
            excluded=value["excluded"],
            removed=tuple(value["removed"]),
            dataset=value["dataset"]["state"],
            dataset_problem=value["dataset"]["problem"],
            dataset_path=Path(value["dataset"]["path"]),
            interrupted=value["interrupted"],
            seconds=value["seconds"],
        )
