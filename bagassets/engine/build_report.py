"""Options of a build, events while it works, and its report."""

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Self

from bagassets.base.alike import told_once
from bagassets.base.escaping import visible
from bagassets.base.json_types import JsonMapping, JsonObject
from bagassets.base.quantities import count_text

if TYPE_CHECKING:
    # Not imported: the command line only waits for the server, and should not import all of this.
    from bagassets.engine.plan import Plan

Result = Literal["built", "hit", "fresh", "skipped", "failed", "stopped"]
OwnResult = Literal["made", "fresh", "skipped", "failed", "not made", "stopped"]
_MOST_REMARKS = 12


@dataclass(frozen=True)
class BuildOptions:
    """Options of a build.

    Attributes:
        jobs: recordings built at the same time.
        retry_failed: retry what failed before on the same input.
        bags: keys, globs or paths of the recordings to build; none = all.
        select: assets to bring up to date, with those that they read; none = all.
        allow_empty: accept an empty bag root even if it had recordings before.
        ignore_disk_space: build even if the disk seems to be too small.
    """

    jobs: int = 1
    retry_failed: bool = False
    bags: tuple[str, ...] = ()
    select: tuple[str, ...] = ()
    allow_empty: bool = False
    ignore_disk_space: bool = False

    @property
    def is_whole(self) -> bool:
        """True if it covers all recordings and assets."""
        return not self.bags and not self.select

    @classmethod
    def from_json(cls, value: JsonObject) -> Self:
        """Inverse of `asdict`; fields that are left out have their defaults."""
        return replace(cls(**value), bags=tuple(value.get("bags", ())), select=tuple(value.get("select", ())))


@dataclass(frozen=True)
class Event:
    """Progress of a build.

    Attributes:
        kind: `planning` now and then while many recordings are planned, `reading` while recordings are read whose
            time changed, `planned` once, then `started`, `done`, `failed` or `stopped` for a recording, or for the
            dataset (with an empty key); in between `where`, when its launcher says where it waits or is executed, or
            its run how far it has come. `own` before runs of the user's own assets, whose keys then say what is made.
        key: partition key.
        message: why it failed, where it is, what is planned, how far planning or reading is, or that it was made ahead.
        sizes: for `planned`, recording that needs a run -> bytes; for `own`, one entry for each run.
        share: for `where`, how much of the recording the present pass has read, 0 to 1, if its run says so.
    """

    kind: Literal["planning", "reading", "planned", "own", "started", "where", "done", "failed", "stopped"]
    key: str = ""
    message: str = ""
    sizes: Mapping[str, int] = field(default_factory=dict)
    share: float | None = None

    @classmethod
    def planning(cls, done: int, total: int) -> Self:
        """Return the event that so many recordings have been planned."""
        return cls("planning", message=f"Planned {done} of {count_text(total, 'recording')}")

    @property
    def is_preparation(self) -> bool:
        """True if it says how far the work is that comes before (and between) the runs."""
        return self.kind in {"planning", "reading"}


@dataclass(frozen=True)
class BagOutcome:
    """The result of a build for one recording.

    Attributes:
        result: `built` (something ran), `hit` (the store had everything, only Dagster's records were brought up to
            date), `fresh` (nothing to do), `skipped`, `failed`, or `stopped` before it was done.
        reason: why it was skipped or failed.
        seconds: wall time of its run; 0 if there was none.
    """

    result: Result
    reason: str = ""
    seconds: float = 0.0


@dataclass(frozen=True)
class OwnOutcome:
    """What became of an asset of the user's.

    Attributes:
        per_recording: there is one of each recording; else one for all.
        results: result -> number of recordings, or 1 if it is one for all.
        reasons: partition key, "" if it is one for all -> result and reason, of what failed or was not made.
    """

    per_recording: bool
    results: Mapping[str, int]
    reasons: Mapping[str, list[str]] = field(default_factory=dict)


@dataclass(frozen=True)
class Remark:
    """A problem that a check found in a recording that was built.

    Attributes:
        key: partition key; empty for the dataset.
        severity: `error` or `warn`.
        check: name of the check.
        problem: a sentence about the first problem.
    """

    key: str
    severity: str
    check: str
    problem: str


def remark_lines(remarks: Iterable[Remark]) -> list[str]:
    """Return remarks as lines: errors first, what is alike once, names, too, and no more than fits on a screen."""
    ranked = sorted(remarks, key=lambda remark: remark.severity != "error")
    told = told_once(
        ((one.severity, one.check), one.key, one.problem.removeprefix(f"{one.key}: ")) for one in ranked
    )
    lines = [
        visible(f"{one.kind[0]} {one.title or 'dataset'}: {one.text} ({one.kind[1]})")
        for one in told[:_MOST_REMARKS]
    ]
    more = sum(len(one.names) for one in told[_MOST_REMARKS:])
    return [*lines, *([f"{more} more; `bagassets check` lists all."] if more else [])]


@dataclass
class BuildReport:
    """The report of a build.

    Attributes:
        plan: the state of everything after the build; None in a report from another process.
        outcomes: recording -> its result.
        excluded: path below the bag root -> why the recipe leaves it out.
        removed: recordings that are gone.
        remarks: problems that checks found in what this build made.
        duplicates: recording -> another one with the same content, which represents it in the dataset.
        left_out: recording that this build was not about -> why it is not in the dataset.
        moved: recording that this build moved to another split -> the old split and the new one.
        pinned: those of `moved` that the recipe pins.
        splits: split -> its share of recordings and time (`SplitShare.as_json`), and whether that `is_far` from the
            share in the recipe.
        dataset: `updated`, `fresh`, `failed`, `stopped`, `not made`, or `not selected`.
        dataset_problem: why the dataset could not be made, or is empty.
        dataset_path: its dataroot.
        datasets: asset of each dataset -> `path` and `state` (as `dataset`, which is that of the first one).
        own: asset of the user's -> what became of it.
        own_left_out: asset of the user's -> why builds do not make it.
        own_problem: why none of the user's assets are known, if so.
        interrupted: True if somebody stopped the build.
        seconds: wall time.
    """

    plan: "Plan | None" = None
    outcomes: dict[str, BagOutcome] = field(default_factory=dict)
    excluded: Mapping[str, str] = field(default_factory=dict)
    removed: tuple[str, ...] = ()
    remarks: tuple[Remark, ...] = ()
    duplicates: Mapping[str, str] = field(default_factory=dict)
    left_out: Mapping[str, str] = field(default_factory=dict)
    moved: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    pinned: tuple[str, ...] = ()
    splits: Mapping[str, JsonMapping] = field(default_factory=dict)
    dataset: str = "fresh"
    dataset_problem: str = ""
    dataset_path: Path = Path()
    datasets: Mapping[str, JsonMapping] = field(default_factory=dict)
    own: dict[str, OwnOutcome] = field(default_factory=dict)
    own_left_out: Mapping[str, str] = field(default_factory=dict)
    own_problem: str = ""
    interrupted: bool = False
    seconds: float = 0.0

    def having(self, *results: Result) -> dict[str, BagOutcome]:
        """Return the recordings with one of `results`."""
        return {key: outcome for key, outcome in self.outcomes.items() if outcome.result in results}

    @property
    def succeeded(self) -> bool:
        """True if nothing failed and nobody stopped the build."""
        own_failed = self.own_problem or any("failed" in one.results for one in self.own.values())
        return not (
            self.interrupted or self.dataset_problem or self.having("failed", "stopped") or own_failed
        )

    def counts(self) -> dict[str, int]:
        """Return result -> number of recordings."""
        results: tuple[Result, ...] = ("built", "hit", "fresh", "skipped", "failed", "stopped")
        return {result: len(self.having(result)) for result in results}

    def as_json(self) -> JsonObject:
        """Return the report as JSON, without the plan."""
        # `asdict` takes its time for each outcome, and there may be thousands.
        value = asdict(replace(self, plan=None, outcomes={}))
        del value["plan"]
        value["outcomes"] = {key: dict(vars(one)) for key, one in self.outcomes.items()}
        for one in (value, *value["outcomes"].values()):
            one["seconds"] = round(one["seconds"], 3)
        value["dataset"] = {
            "state": self.dataset,
            "path": str(value.pop("dataset_path")),
            "problem": value.pop("dataset_problem"),
        }
        return {"recordings": value.pop("outcomes"), "counts": self.counts(), **value}

    @classmethod
    def from_json(cls, value: JsonObject) -> Self:
        """Inverse of `as_json`, without the plan."""
        made = {
            "outcomes": {key: BagOutcome(**bag) for key, bag in value["recordings"].items()},
            "removed": tuple(value["removed"]),
            "pinned": tuple(value["pinned"]),
            "remarks": tuple(Remark(**remark) for remark in value["remarks"]),
            "moved": {key: tuple(splits) for key, splits in value["moved"].items()},
            "dataset": value["dataset"]["state"],
            "dataset_problem": value["dataset"]["problem"],
            "dataset_path": Path(value["dataset"]["path"]),
            "own": {name: OwnOutcome(**one) for name, one in value["own"].items()},
        }
        known = {one.name for one in fields(cls)}
        return cls(**{name: one for name, one in value.items() if name in known} | made)


@dataclass(frozen=True)
class SummaryRow:
    """A row of the summary: what one recording contains; None where that is not known.

    Attributes:
        recording: partition key.
        format: ros1, ros2 or mcap.
        span_s: time from first to last message, seconds.
        counts: what its assets count (`Face.counts`), such as images, sweeps, poses, boxes, scenes and keyframes; each is
            an attribute of the row, too.
        result: see `BagOutcome`.
        reason: why it was skipped or failed.
        lost: channel or topic -> reason -> number of messages or boxes that were lost.
    """

    recording: str
    format: str | None
    span_s: float | None
    counts: Mapping[str, int | None]
    result: str
    reason: str
    lost: Mapping[str, Mapping[str, int]] = field(default_factory=dict)

    def __getattr__(self, name: str) -> int | None:
        """Return one of the counts."""
        try:
            found: int | None = vars(self)["counts"][name]
        except KeyError:
            raise AttributeError(name) from None
        return found

    def as_json(self) -> JsonObject:
        """Return the row as JSON, with the counts among the other fields."""
        return {name: one for name, one in vars(self).items() if name != "counts"} | dict(self.counts)

    @classmethod
    def from_json(cls, value: JsonMapping) -> Self:
        """Inverse of `as_json`."""
        own = {one.name: value[one.name] for one in fields(cls) if one.name in value}
        return cls(**own, counts={name: count for name, count in value.items() if name not in own})
