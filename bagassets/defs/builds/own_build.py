"""Bringing the user's own assets up to date: those downstream of ours that would run by themselves, or that are asked for.

Ours come first. Then everything that can be made is made, a run per code location and partition, and so on until nothing
more can be.
"""

from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import dagster as dg

from bagassets.base.errors import RecipeError
from bagassets.base.json_types import JsonObject
from bagassets.base.quantities import count_text
from bagassets.defs.builds.own_states import OwnState, OwnStates, Survey
from bagassets.defs.builds.pending_work import PendingWork
from bagassets.defs.graph.own_assets import OwnAsset, find_own_assets, inputs_tag
from bagassets.defs.graph.own_location import code_digest, files_of, home_of, load_locations
from bagassets.defs.records.partitions import ACTIVE, PARTITION_TAG
from bagassets.defs.records.workspace import Workspace
from bagassets.defs.runs.execution import CodeLocation
from bagassets.defs.runs.run_pool import EndedRun, Listener, RunPool
from bagassets.engine.build_report import BuildOptions, Event, OwnOutcome, OwnResult
from bagassets.engine.choose import SelectionError, split_names
from bagassets.formats.dataset_build import dataset_code_versions
from bagassets.propose.project import dagster_home

__all__ = ["OwnBuild", "OwnProject", "OwnWork", "load_own"]

_MANUAL = "only with --select"
_TO_MAKE = {"missing", "stale"}
_SAID = {"failed", "not made", "stopped"}  # results with a reason


@dataclass(frozen=True)
class OwnProject:
    """The user's assets of a project, and where it is at home.

    Attributes:
        workspace: the project, below the prefix that the user gave it.
        location: the code location that defines our assets: ours, or the user's if there is a prefix.
        assets: name -> asset, in the order of the graph.
        wanted: those that a build brings up to date.
        left_out: name -> why a build does not.
        problem: why none are known, if so.
        files: what they were read from.
    """

    workspace: Workspace
    location: CodeLocation = field(default_factory=CodeLocation)
    assets: Mapping[str, OwnAsset] = field(default_factory=dict)
    wanted: tuple[str, ...] = ()
    left_out: Mapping[str, str] = field(default_factory=dict)
    problem: str = ""
    files: tuple[str, ...] = ()

    def ours_read_by(self, names: Collection[str]) -> set[str]:
        """Return the assets of ours that some of the user's read, directly or through others of the user's."""
        keys = {read.key for name in self._with_upstream(names) for read in self.assets[name].reads}
        found = {self.workspace.names.asset_of(key) for key in keys}
        return {name for name in found if name is not None}

    def choose(self, selected: Collection[str]) -> "OwnProject":
        """Return the project with only these, and what they read, as wanted."""
        wanted = self._with_upstream(name for name in selected if name in self.assets)
        return replace(self, wanted=tuple(name for name in self.assets if name in wanted), left_out={})

    def _with_upstream(self, names: Iterable[str]) -> set[str]:
        found = set(names) & self.assets.keys()
        for name in reversed(list(self.assets)):  # each stands after what it reads
            if name in found:
                read = {read.key.to_user_string() for read in self.assets[name].reads}
                found |= read & self.assets.keys()
        return found

    def survey(
        self,
        instance: dg.DagsterInstance,
        pending: PendingWork,
        options: BuildOptions,
        *,
        is_dataset_current: bool | None = None,
    ) -> "OwnWork":
        """Return the state of each asset."""
        if not self.assets:
            return OwnWork(self)
        return OwnWork(self, Survey(instance, self, pending, options, is_dataset_current).states)


@dataclass(frozen=True)
class OwnWork:
    """What a build would do to the user's assets.

    Attributes:
        project: which there are.
        states: asset -> partition key -> state.
    """

    project: OwnProject
    states: OwnStates = field(default_factory=dict)

    def having(self, *wanted: str) -> list[tuple[str, str, OwnState]]:
        """Return asset, partition key and state of what is in one of these states, or in any; of what a build is for."""
        return [
            (name, partition, one)
            for name in self.project.wanted
            for partition, one in self.states.get(name, {}).items()
            if not wanted or one.state in wanted
        ]

    def as_json(self) -> JsonObject:
        """Return the states as JSON, and which assets a build leaves out, and why."""
        wanted = self.project.wanted
        states = {
            name: {key: one.as_json() for key, one in self.states.get(name, {}).items()} for name in wanted
        }
        return {
            "assets": states,
            "left_out": dict(self.project.left_out),
            "problem": self.project.problem,
        }

    @property
    def is_settled(self) -> bool:
        """True if a build has nothing to do."""
        return not self.having(*_TO_MAKE, "unknown")

    @property
    def failed(self) -> bool:
        """True if something failed on its current inputs, or could not even be read."""
        return bool(self.project.problem or self.having("failed"))

    @property
    def is_up_to_date(self) -> bool:
        """True if nothing failed either, or waits for what failed."""
        return not self.project.problem and len(self.having("fresh", "skipped")) == len(self.having())


def load_own(workspace: Workspace, options: BuildOptions | None = None) -> OwnProject:
    """Import what `workspace.yaml` names besides ours, and return the assets downstream of ours.

    What cannot be imported is no reason not to build ours: it is the `problem` of the project.

    Args:
        workspace: the project, as far as the instance knows it.
        options: of a build; default: everything.

    Raises:
        RecipeError: it cannot be imported, and something that is selected is not ours, or ours are defined there, below a
            prefix.
        SelectionError: an asset that is selected cannot be made by a build.
    """
    selected = set(split_names(options.select if options else ()))
    ours = ("bag", *workspace.assets.names)
    home = dagster_home(Path(workspace.recipe_file), workspace.recipe)
    try:
        locations = load_locations(home)
    except RecipeError as err:
        if workspace.key_prefix or selected - {*ours, *dataset_code_versions(workspace.recipe)}:
            raise
        return OwnProject(workspace, problem=str(err), files=files_of(home))
    prefix, location = home_of(home, Path(workspace.recipe_file), locations)
    if prefix != workspace.names.prefix:
        workspace = Workspace(recipe_file=workspace.recipe_file, key_prefix=list(prefix))
    if not locations:
        return OwnProject(workspace, files=files_of(home))
    assets, left_out = find_own_assets(locations, workspace.recipe, workspace.names, ours)
    for name in sorted(selected & left_out.keys()):
        raise SelectionError(
            f"{name}: {left_out[name]}, so materialize it in the web UI or with `dagster asset materialize`."
        )
    automatic = tuple(name for name, asset in assets.items() if asset.is_automatic)
    left_out |= {name: _MANUAL for name in assets if name not in automatic}
    project = OwnProject(workspace, location, assets, automatic, left_out, files=files_of(home))
    return project.choose(selected) if selected else project


class OwnBuild:
    """Makes what is to be made.

    Args:
        instance: where runs are recorded, and whose launcher executes them.
        project: the user's assets.
        options: of the build.
        on_event: called when a run begins and when it ends.
    """

    def __init__(
        self,
        instance: dg.DagsterInstance,
        project: OwnProject,
        options: BuildOptions,
        on_event: Listener,
    ) -> None:
        self.interrupted = False
        self._instance, self._project = instance, project
        self._options, self._on_event = options, on_event
        self._code = code_digest()
        self._tried: dict[tuple[str, str], EndedRun | None] = {}

    def work(self, pending: PendingWork, *, is_dataset_current: bool) -> OwnWork:
        """Make everything that can be made; return how it stands then.

        Args:
            pending: the state of our assets, which are up to date as far as they can be.
            is_dataset_current: the datasets on disk are up to date.
        """
        while True:
            work = self._project.survey(
                self._instance, pending, self._options, is_dataset_current=is_dataset_current
            )
            to_make = work.having(*_TO_MAKE)
            # Other runs are about to make some, as those of a sensor.
            runs = self._instance.get_runs(dg.RunsFilter(statuses=ACTIVE)) if to_make else ()
            settled = self._tried.keys() | {
                (key.to_user_string(), run.tags.get(PARTITION_TAG, ""))
                for run in runs
                for key in run.asset_selection or ()
            }
            todo = [one for one in to_make if one[:2] not in settled]
            if not todo or self.interrupted:
                return work
            self._run(todo)

    def _run(self, todo: list[tuple[str, str, OwnState]]) -> None:
        """Make some assets, those of the same partition and code location in one run."""
        self._tried |= {(name, partition): None for name, partition, _ in todo}
        shared: dict[CodeLocation, dict[str, list[tuple[OwnAsset, OwnState]]]] = {}
        for name, partition, state in todo:
            asset = self._project.assets[name]
            shared.setdefault(asset.location, {}).setdefault(partition, []).append((asset, state))
        labels = [
            _label([asset.name for asset, _ in found], partition)
            for by_partition in shared.values()
            for partition, found in by_partition.items()
        ]
        counts = Counter(name for name, _, _ in todo)
        parts = [
            f"{name} of {count_text(number, 'recording')}"
            if self._project.assets[name].is_partitioned
            else name
            for name, number in counts.items()
        ]
        self._on_event(Event("own", sizes=dict.fromkeys(labels, 0), message=f"Then {', '.join(parts)}."))
        for location, by_partition in shared.items():
            if not self.interrupted:
                self._run_in(location, by_partition)

    def _run_in(
        self, location: CodeLocation, by_partition: Mapping[str, list[tuple[OwnAsset, OwnState]]]
    ) -> None:
        made = {partition: [asset.name for asset, _ in found] for partition, found in by_partition.items()}

        def on_event(event: Event) -> None:
            self._on_event(replace(event, key=_label(made[event.key], event.key)))

        batches: list[dict[str, tuple[str, ...]]] = []
        tags: dict[str, dict[str, str]] = {}
        for partition, found in by_partition.items():
            keys = {key.to_user_string() for asset, _ in found for key in asset.together}
            batches.append({partition: tuple(sorted(keys))})
            tags[partition] = {}
            for asset, state in found:
                tags[partition] |= inputs_tag(asset, state.reads, self._code)
        workspace = self._project.workspace
        log, names = workspace.recipe.state / "code-server-own.log", workspace.names
        key_of = dg.AssetKey.from_user_string
        with RunPool(
            self._instance, names, self._options.jobs, on_event, log, location, key_of, tags
        ) as pool:
            pool.work(batches)
            self.interrupted = pool.interrupted
            for partition, ended in pool.ended.items():
                for name in made[partition]:
                    self._tried[name, partition] = ended

    @property
    def has_run(self) -> bool:
        """True if there were any runs."""
        return bool(self._tried)

    def outcomes(self, work: OwnWork) -> dict[str, OwnOutcome]:
        """Return what became of each asset that the build was for."""
        found = {}
        for name in self._project.wanted:
            results = {
                partition: self._outcome(name, partition, state)
                for partition, state in work.states[name].items()
            }
            found[name] = OwnOutcome(
                self._project.assets[name].is_partitioned,
                dict(Counter(result for result, _ in results.values())),
                {key: list(one) for key, one in results.items() if one[0] in _SAID},
            )
        return found

    def _outcome(self, name: str, partition: str, state: OwnState) -> tuple[OwnResult, str]:
        was_tried = (name, partition) in self._tried
        ended = self._tried.get((name, partition))
        if state.state == "fresh":
            return ("made" if was_tried else "fresh"), ""
        if state.state == "skipped":
            return "skipped", ""
        if state.state == "failed" and not was_tried:
            return "failed", f"{state.reason} (failed before; --retry-failed tries again)"
        if ended is not None and not ended.stopped and ended.problem is not None:
            return "failed", ended.problem
        if self.interrupted:
            return "stopped", "the build was interrupted; the next one carries on"
        return "not made", "another run is about to make it" if state.state in _TO_MAKE else state.reason


def _label(names: Collection[str], partition: str) -> str:
    return f"{', '.join(names)} of {partition}" if partition else ", ".join(names)
