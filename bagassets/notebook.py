"""Building from Python, as in a notebook: `bagassets.build(recipe)`.

It does what the command does, by the same way: the build runs on the server of the project, so nothing of Dagster is
imported here.
"""

import json
import os
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from bagassets.base.errors import BagAssetsError, RecipeError
from bagassets.base.json_types import JsonMapping, JsonObject
from bagassets.cli.progress import LinesProgress, LiveProgress, SilentProgress
from bagassets.cli.remote import InterruptedBuildError, report_of_build, scratch_folders
from bagassets.cli.summary import counts_line
from bagassets.engine.build_report import BuildOptions, BuildReport, Event, OwnOutcome, Remark, SummaryRow
from bagassets.recipe.inline import parse_inline, write_inline
from bagassets.recipe.yaml_text import read_yaml

# What an inline recipe is called in errors, in the current folder: its paths are relative to that.
_INLINE = "<recipe>"


@dataclass(frozen=True, repr=False)
class Report:
    """What a build did.

    Attributes:
        recordings: key -> what it contains, its `result` (`built`, `hit`, `fresh`, `skipped`, `failed`, `stopped`), the
            `reason`, and what was `lost`.
        dataset: folder of the nuScenes dataset, for `bagassets.open_dataset`.
        dataset_state: `updated`, `fresh`, `failed`, `not made`, or `not selected`.
        dataset_problem: why the datasets could not be made, or are empty; "" if all is well.
        remarks: problems that checks found in what was built.
        duplicates: recording -> another one with the same content, which represents it in the dataset.
        removed: recordings that are gone.
        splits: split -> its share of recordings and time.
        own: asset of your own -> what became of it (see docs/steps.md).
        own_problem: why none of your own assets are known; "" if they are.
        seconds: wall time.
        summary: all of it in a line.
        succeeded: nothing failed.
    """

    recordings: Mapping[str, SummaryRow]
    dataset: Path
    dataset_state: str
    dataset_problem: str = ""
    remarks: Sequence[Remark] = ()
    duplicates: Mapping[str, str] = field(default_factory=dict)
    removed: Sequence[str] = ()
    splits: Mapping[str, JsonMapping] = field(default_factory=dict)
    own: Mapping[str, OwnOutcome] = field(default_factory=dict)
    own_problem: str = ""
    seconds: float = 0.0
    summary: str = ""
    succeeded: bool = True

    @property
    def built(self) -> tuple[str, ...]:
        """Recordings of which something was made."""
        return self._having("built")

    @property
    def fresh(self) -> tuple[str, ...]:
        """Recordings for which everything was there."""
        return self._having("fresh", "hit")

    @property
    def failed(self) -> Mapping[str, str]:
        """Recordings that failed -> why."""
        return {key: self.recordings[key].reason for key in self._having("failed", "stopped")}

    @property
    def skipped(self) -> Mapping[str, str]:
        """Recordings that take no part -> why."""
        return {key: self.recordings[key].reason for key in self._having("skipped")}

    @property
    def lost(self) -> Mapping[str, Mapping[str, Mapping[str, int]]]:
        """Recording -> channel or topic -> reason -> number of messages or boxes that were lost."""
        return {key: row.lost for key, row in self.recordings.items() if row.lost}

    def __repr__(self) -> str:
        return f"<Report: {self.summary}; dataset {self.dataset} ({self.dataset_state})>"

    def _having(self, *results: str) -> tuple[str, ...]:
        return tuple(key for key, row in self.recordings.items() if row.result in results)


def build(
    recipe: str | Path | Mapping[str, object],
    *,
    state: str | Path | None = None,
    progress: bool | Callable[[Event], None] = True,
    jobs: int | None = None,
    bags: Sequence[str] = (),
    select: Sequence[str] = (),
    retry_failed: bool = False,
    allow_empty: bool = False,
    ignore_disk_space: bool = False,
) -> Report:
    """Bring the datasets of a recipe up to date, as `bagassets build` does, and report what was done.

    A recording that fails does not stop the others: it is in `Report.failed`. An interrupt (Ctrl-C, *Interrupt the
    kernel*) ends the runs as canceled and raises KeyboardInterrupt; the next build goes on from there.

    Args:
        recipe: the path of a recipe; or a recipe itself, as a mapping or as text of several lines, whose paths
            are relative to the current folder.
        state: folder for the store and the state of a recipe without a file. None: that of the recipe or, if it
            names none, one that is removed in the end, so that the next build does everything again; the dataset stays.
        progress: True shows it (a bar on a terminal, else lines); a callable gets every event; False shows nothing.
        jobs: recordings built at the same time; None for as many as there are processors.
        bags: keys, globs or paths of the recordings to build; none: all.
        select: assets to bring up to date, with those that they read; none: all.
        retry_failed: retry what failed before on the same input.
        allow_empty: accept a bag root without recordings where there were some before.
        ignore_disk_space: build even if the disk seems to be too small.

    Raises:
        BagAssetsError: the recipe, the recordings' folder, or a disk is not usable.
        KeyboardInterrupt: somebody interrupted it.
    """
    processors = os.cpu_count() or 1
    options = BuildOptions(
        min(jobs or processors, 2 * processors), retry_failed, tuple(bags), tuple(select), allow_empty, ignore_disk_space
    )  # fmt: skip
    with _recipe_file(recipe, state) as file:
        try:
            value = _build(file, options, progress)
        except BagAssetsError as err:
            if isinstance(recipe, str | Path) and "\n" not in str(recipe):
                raise
            # The file is ours, and may be gone.
            name = re.compile(re.escape(str(file)) + r"(:\d+)?")
            raise type(err)(*(name.sub(_INLINE, line) for line in err.args)) from None
    report = BuildReport.from_json(value)
    if report.interrupted:
        raise KeyboardInterrupt(counts_line(report))
    return Report(
        recordings={row["recording"]: SummaryRow.from_json(row) for row in value["summary"]},
        dataset=report.dataset_path,
        dataset_state=report.dataset,
        dataset_problem=report.dataset_problem,
        remarks=report.remarks,
        duplicates=report.duplicates,
        removed=report.removed,
        splits=report.splits,
        own=report.own,
        own_problem=report.own_problem,
        seconds=report.seconds,
        summary=counts_line(report),
        succeeded=report.succeeded,
    )


def _build(file: Path, options: BuildOptions, progress: bool | Callable[[Event], None]) -> JsonObject:
    with _display(progress) as display:
        listener = display if isinstance(progress, bool) else progress
        try:
            return report_of_build(file, options, listener, None)
        except InterruptedBuildError as err:
            raise KeyboardInterrupt from err


def _display(progress: bool | Callable[[Event], None]) -> SilentProgress:
    if progress is not True:
        return SilentProgress()
    # Notebooks show standard error as if something were wrong.
    return LiveProgress() if sys.stderr.isatty() else LinesProgress(err=False)


@contextmanager
def _recipe_file(recipe: str | Path | Mapping[str, object], state: str | Path | None) -> Iterator[Path]:
    """Have the recipe in a file; what was made for that alone is removed afterwards."""
    if isinstance(recipe, Path) or (isinstance(recipe, str) and "\n" not in recipe):
        if state is not None:
            raise RecipeError(
                f"{recipe}: `state` is for recipes without a file; this one has a field of that name."
            )
        yield Path(recipe).absolute()
        return
    text = recipe if isinstance(recipe, str) else json.dumps(dict(recipe), default=os.fspath)
    given = parse_inline(text, Path.cwd() / _INLINE)
    data, _ = read_yaml(text, Path.cwd() / _INLINE)
    if state is None and "state" not in data:
        with scratch_folders(given.output, parents=True) as (folder, beside):
            yield write_inline(given, folder, given.store or beside)
        return
    yield write_inline(given, given.state if state is None else Path(state).absolute(), given.store)
