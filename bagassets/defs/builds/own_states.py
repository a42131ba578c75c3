"""The user's own assets of a project, which of them a build brings up to date, and how they stand."""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import dagster as dg

from bagassets.base.errors import RecipeError, SelectionError
from bagassets.base.json_types import JsonObject
from bagassets.defs.builds.pending_work import PendingWork
from bagassets.defs.graph.own_assets import OwnAsset, Versions, find_own_assets, inputs_tag, told_inputs
from bagassets.defs.graph.own_location import code_digest, files_of, home_of, load_locations
from bagassets.defs.records.batches import PARTITION_TAG
from bagassets.defs.records.events import runs_of
from bagassets.defs.records.naming import DATASET_INPUTS
from bagassets.defs.records.workspace import Workspace
from bagassets.defs.runs.execution import CodeLocation, failure_of
from bagassets.engine.build_report import BuildOptions
from bagassets.engine.choose import split_names
from bagassets.engine.plan import AssetState, Recorded
from bagassets.engine.targets import TO_MAKE, Evidence, Read, state_as_read, target_state
from bagassets.formats.dataset_build import dataset_code_versions
from bagassets.propose.project import dagster_home

_MANUAL = "only with --select"


@dataclass(frozen=True)
class OwnProject:
    """The user's assets of a project, and where it is at home; once they were surveyed, also how they stand.

    Attributes:
        workspace: the project, below the prefix that the user gave it.
        location: the code location that defines our assets: ours, or the user's if there is a prefix.
        assets: name -> asset, in the order of the graph.
        wanted: those that a build brings up to date.
        left_out: name -> why a build does not.
        problem: why none are known, if so.
        files: what they were read from.
        states: asset -> partition key, "" for one of all recordings -> state.
        evidence: the same -> what is known of it.
        datasets: dataset that a build brings up to date -> state.
    """

    workspace: Workspace
    location: CodeLocation = field(default_factory=CodeLocation)
    assets: Mapping[str, OwnAsset] = field(default_factory=dict)
    wanted: tuple[str, ...] = ()
    left_out: Mapping[str, str] = field(default_factory=dict)
    problem: str = ""
    files: tuple[str, ...] = ()
    states: Mapping[str, Mapping[str, AssetState]] = field(default_factory=dict)
    evidence: Mapping[str, Mapping[str, Evidence]] = field(default_factory=dict)
    datasets: Mapping[str, AssetState] = field(default_factory=dict)

    def ours_read_by(self, names: Collection[str]) -> set[str]:
        """Return the assets of ours that some of the user's read, directly or through others of the user's."""
        read = {read.name for name in self.with_upstream(names) for read in self.assets[name].reads}
        found = {self.workspace.names.asset_of(dg.AssetKey.from_user_string(name)) for name in read}
        return {name for name in found if name is not None}

    def with_upstream(self, names: Iterable[str]) -> set[str]:
        """Return those of `names` that are the user's, with what they read of the user's."""
        found = set(names) & self.assets.keys()
        for name in reversed(list(self.assets)):  # each stands after what it reads
            if name in found:
                found |= {read.name for read in self.assets[name].reads} & self.assets.keys()
        return found

    def survey(self, pending: PendingWork, *, is_dataset_current: bool = False) -> "OwnProject":
        """Return the project with the state of each asset, for the chosen recordings.

        Args:
            pending: the state of our assets. If it is asked for, what failed on the same inputs is to be made.
            is_dataset_current: the datasets are up to date, whatever `pending` says.
        """
        if not self.assets:
            return replace(self, datasets=pending.dataset_states)
        states = pending.dataset_states
        never = {name: one for name, one in states.items() if one.state == "blocked"}
        survey = _Survey(self, pending, never if is_dataset_current else states)
        for asset in self.assets.values():  # each after those that it reads
            survey.add(asset)
        return replace(self, states=survey.states, evidence=survey.evidence, datasets=pending.dataset_states)

    @property
    def targets(self) -> dict[str, Mapping[str, AssetState]]:
        """The states of all that a build brings up to date besides assets of recordings: datasets, then assets of the user's."""
        datasets = {name: {"": one} for name, one in self.datasets.items()}
        return {**datasets, **{name: self.states.get(name, {}) for name in self.wanted}}

    def having(self, *wanted: str) -> list[tuple[str, str, AssetState]]:
        """Return asset, partition key and state of what is in one of these states, or in any; of what a build is for."""
        return [
            (name, partition, one)
            for name in self.wanted
            for partition, one in self.states.get(name, {}).items()
            if not wanted or one.state in wanted
        ]

    def as_json(self) -> JsonObject:
        """Return the states of all targets as JSON, and which assets a build leaves out, and why."""
        reasons = {name: one.reason for name, one in self.datasets.items() if one.state != "fresh"}
        states = {
            name: {key: one.as_json() for key, one in self.targets[name].items()} for name in self.wanted
        }
        return {
            "datasets": {name: one.state for name, one in self.datasets.items()},
            "dataset_reasons": reasons,
            "own": {"assets": states, "left_out": dict(self.left_out), "problem": self.problem},
        }

    @property
    def is_settled(self) -> bool:
        """True if a build has nothing to do."""
        return not self.having(*TO_MAKE, "unknown")

    @property
    def failed(self) -> bool:
        """True if something failed on its current inputs, or could not even be read."""
        return bool(self.problem or self.having("failed"))

    @property
    def is_up_to_date(self) -> bool:
        """True if nothing failed either, or waits for what failed."""
        return not self.problem and len(self.having("fresh", "skipped")) == len(self.having())


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
        workspace = workspace.below(prefix)
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
    if not selected:
        return project
    wanted = project.with_upstream(selected)
    return replace(project, wanted=tuple(name for name in assets if name in wanted), left_out={})


class _Survey:
    """Finds out how the user's assets stand; those that are not wanted, and are read by others, are taken as they are.

    Args:
        project: the user's assets.
        pending: the state of our assets.
        datasets: state of the datasets that are brought up to date as well.

    Attributes:
        states: see `OwnProject`.
        evidence: likewise.
    """

    def __init__(self, project: OwnProject, pending: PendingWork, datasets: Mapping[str, AssetState]) -> None:
        self.states: dict[str, dict[str, AssetState]] = {}
        self.evidence: dict[str, dict[str, Evidence]] = {}
        self._project, self._bags = project, pending.plan.bags
        self._recordings = sorted(pending.asked.chosen & pending.plan.bags.keys())
        self._records, self._names = project.workspace.records, project.workspace.names
        self._instance, self._versions = self._records.instance, Versions(self._records, pending.leaving)
        self._code, self._retry_failed = code_digest(), pending.asked.retry_failed
        behind = (one for one in datasets.values() if one.state != "fresh")
        self._datasets = {**datasets, DATASET_INPUTS: next(behind, AssetState("fresh", ""))}

    def add(self, asset: OwnAsset) -> None:
        """Find out how an asset stands, whose inputs of the user's have been added."""
        recorded = self._recorded(asset)
        runs: dict[str, str] = {}
        if any(read.how == "all" for read in asset.reads):  # of which only the run says what it has read
            found = runs_of(self._instance, {one.run_id for one in recorded.values()})
            runs = {run.run_id: told_inputs(run, asset.key) for run in found}

        def told(run_id: str) -> str | None:
            if run_id not in runs and (run := self._instance.get_run_by_id(run_id)) is not None:
                runs[run_id] = told_inputs(run, asset.key)
            return runs.get(run_id)

        self.evidence[asset.name], self.states[asset.name] = {}, {}
        for partition in self._recordings if asset.is_partitioned else [""]:
            now, last = self._versions.read_by(asset, partition), recorded.get(partition)
            before = {} if last is None else last.inputs
            evidence = Evidence(
                now,
                last,
                {read.name: before.get(self._names.shorten(read.name), "") for read in asset.reads},
                partial(told, "" if last is None else last.run_id),
                failure=(lambda: "") if self._retry_failed else partial(self._failure, asset, partition, now),
            )
            self.evidence[asset.name][partition] = evidence
            above = ((read, state) for read in asset.reads for state in self._above(read, partition))
            self.states[asset.name][partition] = target_state(asset, evidence, above)

    def _above(self, read: Read, partition: str) -> Iterable[AssetState]:
        """Return the states of something that is read, if a build brings it up to date, too; the rest is taken as it is."""
        ours = self._names.asset_of(dg.AssetKey.from_user_string(read.name))
        if read.name in self._project.wanted:
            states = self.states[read.name]
            return states.values() if read.how == "all" else [states[partition if read.how == "same" else ""]]
        if read.name in self._project.assets:
            is_there = self._versions.of(read, partition) is not None
            return [] if is_there else [AssetState("blocked", f"{read.name} was never made")]
        if read.how == "whole":
            return [state for name, state in self._datasets.items() if name == ours]
        bags = [self._bags[partition]] if read.how == "same" else self._bags.values()
        return (
            state_as_read(bag, ours, read.name) for bag in bags if ours is not None and ours in bag.assets
        )

    def _recorded(self, asset: OwnAsset) -> dict[str, Recorded]:
        if asset.is_partitioned:
            found = self._records.fetch(self._records.latest_ids([asset.key]), self._recordings)
            return {key: made[asset.key] for key, made in found.items() if asset.key in made}
        newest = self._records.whole(asset.key)
        return {} if newest is None else {"": newest}

    def _failure(self, asset: OwnAsset, partition: str, reads: Mapping[str, str]) -> str:
        """Return why the last run with the same inputs failed, or "" if it did not."""
        tags = inputs_tag(asset, reads, self._code) | ({PARTITION_TAG: partition} if partition else {})
        last = self._instance.get_runs(dg.RunsFilter(tags=tags), limit=1)
        if not last or last[0].status != dg.DagsterRunStatus.FAILURE:
            return ""
        return failure_of(self._instance, last[0]) or f"run {last[0].run_id} failed"
