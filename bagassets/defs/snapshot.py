"""Leaving a snapshot for the next build when this one found that there is nothing to do."""

from contextlib import suppress
from pathlib import Path

import dagster as dg

from bagassets.defs.events import database_place
from bagassets.defs.workspace import Workspace, partitions_name
from bagassets.engine.dataset_build import dataset_code_versions, dataset_folders
from bagassets.engine.named_files import files_beside, named_files
from bagassets.engine.plan_memo import artifacts_of
from bagassets.engine.plan_model import Plan
from bagassets.engine.publication import Publication
from bagassets.quick import snapshot
from bagassets.quick.build import code_stamp
from bagassets.quick.looks import Doubt
from bagassets.recipe.project import dagster_home

__all__ = ["SnapshotWriter"]


class SnapshotWriter:
    """Looks at everything before a plan is made, and writes that down if the plan has nothing to do.

    What changes while the plan is made then differs from the snapshot, and the next build looks closer.
    """

    def __init__(self, instance: dg.DagsterInstance, workspace: Workspace) -> None:
        self._recipe = workspace.recipe
        self._before: snapshot.Before | None = None
        recipe_file = Path(workspace.recipe_file).absolute()
        database = database_place(instance)
        config = dagster_home(recipe_file, self._recipe) / "dagster.yaml"
        # A database that is named by a variable may be another one next time.
        if database is None or "env:" in config.read_text("utf-8"):
            return
        files = [str(path) for path in named_files(self._recipe)]
        files += [str(folder) for folder in self._recipe.bags.message_definitions]
        if any(rig.annotation_files for rig in self._recipe.rigs):
            # Label files may lie outside the bag root.
            recordings = workspace.discover().found.values()
            files += [str(path) for found in recordings for path in files_beside(self._recipe, found)]
        self._places = snapshot.Places(
            recipe=str(recipe_file),
            files=[*files, str(config)],
            bag_root=str(self._recipe.bags.root),
            database=database,
            partitions=partitions_name(self._recipe),
            artifacts=str(self._recipe.store_path / "artifacts"),
        )
        with suppress(Doubt):
            self._before = snapshot.look_before(code_stamp(str(recipe_file)), self._places)

    def write(self, plan: Plan) -> None:
        """Write the snapshot of a plan with nothing to do; where that is not possible, leave none."""
        state = str(self._recipe.state)
        bags = plan.bags.values()
        if self._before is None or not all(bag.settled for bag in bags):
            snapshot.remove(state)
            return
        skipped = sum(bag.skipped is not None for bag in bags)
        counts = f"{len(plan.bags) - skipped} fresh" + (f", {skipped} skipped" if skipped else "")
        try:
            snapshot.save(
                state,
                self._before,
                self._places,
                artifacts={digest for bag in bags for digest in artifacts_of(bag)},
                published=[
                    str(Publication(self._recipe.state, asset).folder)
                    for asset in dataset_code_versions(self._recipe)
                ],
                lines=[
                    f"{counts}: nothing to do",
                    *(f"dataset: {folder} (up to date)" for folder in dataset_folders(self._recipe).values()),
                ],
            )
        except (Doubt, OSError):
            snapshot.remove(state)
