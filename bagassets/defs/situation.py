"""How things are, and what a build would do about it; the command line's view of the plan."""

import os
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import dagster as dg

from bagassets.build.build_report import BuildOptions
from bagassets.build.choose import choose_assets, choose_recordings
from bagassets.build.plan_model import Plan
from bagassets.defs.databases import database_in_words
from bagassets.defs.dataset import dataset_is_current
from bagassets.defs.planning import Planned, plan_again, plan_now
from bagassets.defs.runs import open_instance
from bagassets.defs.sqlite_files import kept_open
from bagassets.defs.workspace import Workspace
from bagassets.formats.catalogue import MAIN
from bagassets.formats.dataset_build import (
    dataset_code_versions,
    datasets_of,
    deal_contents,
    split_on_disk,
    without_scenes,
)
from bagassets.propose.project import dagster_home
from bagassets.recipe.model import Recipe
from bagassets.splits import moves
from bagassets.store.store import Store
from bagassets.store.writable import require_writable
from bagassets.trace import span

__all__ = ["Situation", "opened", "survey", "survey_again", "would_move"]


@dataclass(frozen=True)
class Situation:
    """The state of everything as it is now, and what a build would do about it.

    Attributes:
        planned: states of recordings, and what a dataset would be made from.
        dataset_is_current: the datasets on disk were made from just that.
        chosen: the recordings that were asked for.
        todo: recordings that need a run -> the assets to materialize.
        datasets: the datasets that were asked for.
    """

    planned: Planned
    dataset_is_current: bool
    chosen: frozenset[str]
    todo: Mapping[str, tuple[str, ...]]
    datasets: tuple[str, ...]

    @property
    def plan(self) -> Plan:
        """The states of all recordings."""
        return self.planned.plan

    @property
    def failed(self) -> dict[str, str]:
        """The recordings asked for that failed on the input they have -> why."""
        bags = {key: bag.failed for key, bag in self.plan.bags.items() if key in self.chosen}
        return {key: reason for key, reason in bags.items() if reason is not None}

    @property
    def is_settled(self) -> bool:
        """True if a build would do nothing."""
        return not self.todo and not self.plan.removed and (self.dataset_is_current or not self.datasets)


def survey(
    instance: dg.DagsterInstance, workspace: Workspace, options: BuildOptions | None = None
) -> Situation:
    """Look at everything and decide, changing nothing.

    Raises:
        BagAssetsError: the recipe or the bag root is not usable, or there is no such recording.
    """
    with span("plan"):
        planned = plan_now(instance, workspace)
    return _situation(instance, workspace, planned, options or BuildOptions())


def survey_again(
    instance: dg.DagsterInstance, workspace: Workspace, before: Situation, worked_on: Collection[str]
) -> Situation:
    """Decide again after runs, see `plan_again`, for a build of everything."""
    with span("plan"):
        planned = plan_again(instance, workspace, before.planned, worked_on)
    return _situation(instance, workspace, planned, BuildOptions())


def _situation(
    instance: dg.DagsterInstance, workspace: Workspace, planned: Planned, options: BuildOptions
) -> Situation:
    recipe = workspace.recipe
    recordings = planned.discovery.recordings
    chosen = choose_recordings(recordings, options.bags) if options.bags else frozenset(recordings)
    datasets = tuple(dataset_code_versions(recipe))
    wanted = choose_assets(("bag", *workspace.assets.names, *datasets), options.select)
    made_from = {asset: dataset.kind.part for asset, dataset in datasets_of(recipe).items()}
    made_from["trajectory_map"] = "ego_poses"
    select = (
        None
        if wanted is None
        else workspace.assets.with_upstream(made_from.get(name, name) for name in wanted)
    )
    todo = {}
    for key, bag in planned.plan.bags.items():
        if key in chosen and (assets := bag.to_run(retry_failed=options.retry_failed, select=select)):
            todo[key] = assets
    is_current = dataset_is_current(instance, recipe, planned.inputs)
    asked = datasets if wanted is None else tuple(name for name in datasets if name in wanted)
    return Situation(planned, is_current, chosen, todo, asked)


def would_move(situation: Situation, recipe: Recipe) -> dict[str, tuple[str, str]]:
    """Return recording -> the split it is in and the one that a build would put it into, if that is another one."""
    inputs = situation.planned.inputs.parts
    entering = {part.key: part.content for part in inputs.get(MAIN.name, ())}
    for key in situation.todo:
        bag = situation.plan.bags[key]
        if bag.skipped is None and bag.unusable is None:
            entering[key] = bag.assets["bag"].data_version or key
    made = {name: {part.key: part.artifact for part in parts} for name, parts in inputs.items()}
    dealt = deal_contents(entering, recipe.splits, without_scenes(Store(recipe.store_path), made))
    return moves(split_on_disk(recipe), dealt)


@contextmanager
def opened(recipe_file: Path) -> Iterator[tuple[dg.DagsterInstance, Workspace]]:
    """Open the Dagster instance of a recipe.

    Raises:
        RecipeError: the recipe is missing or wrong, or its project is another recipe's.
        StoreError: the state folder cannot be written, or the database cannot be used.
    """
    workspace = Workspace(recipe_file=str(recipe_file.absolute()))
    require_writable(workspace.recipe.state)
    home = dagster_home(recipe_file.absolute(), workspace.recipe)
    os.environ["BAGASSETS_RECIPE"] = str(recipe_file.absolute())
    with database_in_words(str(home)), open_instance(str(home)) as instance, kept_open(instance):
        yield instance, workspace
