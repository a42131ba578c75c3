"""What a build has to do, as the plan of the instance says; the commands of a project start here."""

import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from bagassets.defs.graph.dataset import dataset_states
from bagassets.defs.records.databases import are_files
from bagassets.defs.records.events import all_assets
from bagassets.defs.records.instance_plan import planner_of
from bagassets.defs.records.instances import open_instance
from bagassets.defs.records.partitions import active_runs, held_by_backfills
from bagassets.defs.records.projects import noted_prefix
from bagassets.defs.records.workspace import Workspace
from bagassets.engine.build_report import BuildOptions
from bagassets.engine.choose import choose_assets, choose_recordings
from bagassets.engine.plan import AssetState, Plan
from bagassets.engine.splits import moves
from bagassets.engine.targets import TO_MAKE
from bagassets.formats.dataset_build import (
    DatasetInputs,
    dataset_code_versions,
    made_once,
    results_to_come,
    select_inputs,
    split_on_disk,
)
from bagassets.propose.project import dagster_home
from bagassets.recipe import load_recipe
from bagassets.recipe.model import Recipe
from bagassets.recordings.discover import Discovery
from bagassets.store.writable import require_writable

if TYPE_CHECKING:
    from bagassets.defs.builds.own_states import OwnProject


@dataclass(frozen=True)
class Asked:
    """What a build is asked for.

    Attributes:
        chosen: partition keys of recordings.
        assets: assets of recordings, with those that they read; None for all.
        datasets: their assets.
        retry_failed: what failed before on the same input, too.
    """

    chosen: frozenset[str]
    assets: tuple[str, ...] | None
    datasets: tuple[str, ...]
    retry_failed: bool


@dataclass(frozen=True)
class PendingWork:
    """The plan of all recordings, the state of the datasets, and what a build would do about them as it was asked.

    Attributes:
        plan: state of each asset of each recording.
        asked: what the build is asked for.
        inputs: the inputs of the datasets.
        states: dataset -> state.
        todo: recording that needs a run -> the assets to materialize.
        held: recording that is gone -> what its removal waits for; see `held_by_backfills`.
    """

    plan: Plan
    asked: Asked
    inputs: DatasetInputs
    states: Mapping[str, AssetState]
    todo: Mapping[str, tuple[str, ...]]
    held: Mapping[str, str]

    @property
    def failed(self) -> dict[str, str]:
        """The chosen recordings that failed on their current input -> why."""
        bags = {key: bag.failed for key, bag in self.plan.bags.items() if key in self.asked.chosen}
        return {key: reason for key, reason in bags.items() if reason is not None}

    @property
    def leaving(self) -> frozenset[str]:
        """The registered recordings that are gone, and whose partitions a build removes."""
        return frozenset(self.plan.removed) - self.held.keys()

    @property
    def dataset_is_current(self) -> bool:
        """True if the datasets that the build was asked for are on disk as made from exactly those inputs."""
        return not any(one.state in TO_MAKE for one in self.dataset_states.values())

    @property
    def is_settled(self) -> bool:
        """True if a build has nothing to do."""
        return not self.todo and not self.plan.removed and self.dataset_is_current

    @property
    def dataset_states(self) -> dict[str, AssetState]:
        """The state of each dataset that the build was asked for."""
        return {name: self.states[name] for name in self.asked.datasets}


def find_pending_work(
    workspace: Workspace,
    options: BuildOptions | None = None,
    own: "OwnProject | None" = None,
    on_planned: Callable[[int, int], None] | None = None,
) -> PendingWork:
    """Plan everything and return what is to be done; nothing is changed.

    Args:
        workspace: recipe, store, records and recordings.
        options: what is asked for; default: everything.
        own: the user's assets, which may be selected.
        on_planned: see `Planner.plan`.

    Raises:
        BagAssetsError: the recipe or the bag root is not usable, or there is no such recording.
    """
    discovery = workspace.discover()
    asked = what_is_asked(workspace, discovery, options or BuildOptions(), own)
    plan = planner_of(workspace, discovery=discovery).plan(on_planned)
    return work_of(workspace, plan, asked)


def what_is_asked(
    workspace: Workspace, discovery: Discovery, options: BuildOptions, own: "OwnProject | None"
) -> Asked:
    """Return what a build is asked for.

    Raises:
        SelectionError: there is no such recording or asset.
    """
    recipe, recordings = workspace.recipe, discovery.recordings
    chosen = choose_recordings(recordings, options.bags) if options.bags else frozenset(recordings)
    datasets = tuple(dataset_code_versions(recipe))
    ours = ("bag", *workspace.assets.names, *datasets)
    wanted = choose_assets((*ours, *(own.assets if own else ())), options.select)
    if wanted is None:
        return Asked(chosen, None, datasets, options.retry_failed)
    if own is not None:
        wanted = (wanted & frozenset(ours)) | own.ours_read_by(wanted)
    parts = {name: one.part for name, one in made_once(recipe).items()}
    assets = workspace.assets.with_upstream(parts.get(name, name) for name in wanted)
    chosen_datasets = tuple(name for name in datasets if name in wanted)
    return Asked(chosen, assets, chosen_datasets, options.retry_failed)


def work_of(workspace: Workspace, plan: Plan, asked: Asked) -> PendingWork:
    """Return what a build would do, as its plan says, and the state of the datasets."""
    todo = {
        key: assets
        for key, bag in plan.bags.items()
        if key in asked.chosen
        and (assets := bag.to_run(retry_failed=asked.retry_failed, select=asked.assets))
    }
    inputs = select_inputs(plan)
    waits_for = results_to_come(workspace.assets, plan, todo, retry_failed=asked.retry_failed)
    states = dataset_states(workspace, inputs, waits_for)
    held = held_by_backfills(workspace.instance, frozenset(plan.removed))
    return PendingWork(plan, asked, inputs, states, todo, held)


def expected_moves(pending: PendingWork, recipe: Recipe) -> dict[str, tuple[str, str]]:
    """Return recording -> its split on disk and its split after a build, where they differ."""
    entering = {}
    for key in pending.todo:
        bag = pending.plan.bags[key]
        if bag.skipped is None and bag.unusable is None:
            entering[key] = bag.assets["bag"].data_version or key
    return moves(split_on_disk(recipe), pending.inputs.dealt(recipe, entering))


def rehearse(recipe_file: Path) -> None:
    """Ask a project's database what a plan asks, for nothing: processes that are forked then find the statements compiled.

    Afterwards it is closed. Other databases than SQLite's, which may keep one waiting, and those that are not there yet, are left
    alone.
    """
    recipe = load_recipe(recipe_file)
    if not are_files(dagster_home(recipe_file.absolute(), recipe)):
        return
    with open_project(recipe_file) as workspace:
        records = workspace.records
        records.fetch(records.latest_ids(all_assets()), sorted(records.live())[:1])
        active_runs(records, ())
        dataset_states(workspace, DatasetInputs({}))


@contextmanager
def open_project(recipe_file: Path) -> Iterator[Workspace]:
    """Open the workspace of a recipe on its Dagster instance, below the prefix that the instance knows it by.

    Raises:
        RecipeError: the recipe is missing or wrong, or its project is another recipe's.
        StoreError: the state folder cannot be written, or the database cannot be used.
    """
    workspace = Workspace(recipe_file=str(recipe_file.absolute()))
    require_writable(workspace.recipe.state)
    home = dagster_home(recipe_file.absolute(), workspace.recipe)
    os.environ["BAGASSETS_RECIPE"] = str(recipe_file.absolute())
    with open_instance(str(home)) as instance:
        prefix = noted_prefix(instance, recipe_file)
        yield workspace.on(instance).below(prefix) if prefix else workspace.on(instance)
