"""The snapshot that a build with nothing left to do keeps for the next build."""

from collections.abc import Collection, Iterable, Sequence
from contextlib import suppress
from pathlib import Path

import dagster as dg

from bagassets.base.fingerprints import PlanNeeded
from bagassets.defs.records.events import event_database
from bagassets.defs.records.instance_plan import workspace_fingerprint
from bagassets.defs.records.workspace import Workspace
from bagassets.engine.build_report import Remark, remark_lines
from bagassets.engine.freshness import decide
from bagassets.engine.inputs import files_beside, named_files
from bagassets.engine.plan import Plan
from bagassets.formats.dataset_build import dataset_code_versions, dataset_folders
from bagassets.propose.project import dagster_home
from bagassets.recipe.load import paths_written
from bagassets.recordings.join_parts import FOR_NOW


class Snapshot:
    """The fingerprints of all inputs, taken before a plan is made, and saved if the plan has nothing to do.

    So whatever changes while the plan is made differs from the snapshot, and the next build plans in full.
    """

    def __init__(
        self, instance: dg.DagsterInstance, workspace: Workspace, own_files: Sequence[str] = ()
    ) -> None:
        self._recipe = workspace.recipe
        self._fingerprints: list[str] | None = None
        recipe_file = Path(workspace.recipe_file).absolute()
        # Where the events of assets are: the file of SQLite, or the URL of PostgreSQL; other databases have neither.
        database = event_database(instance) or getattr(instance.event_log_storage, "postgres_url", None)
        config = dagster_home(recipe_file, self._recipe) / "dagster.yaml"
        # If a variable names the database, it may be another one next time.
        if database is None or "env:" in config.read_text("utf-8"):
            return
        files, folders = named_files(self._recipe)
        # A dagster.yaml in the project folder would take precedence.
        beside = [config, recipe_file.with_name(config.name), *map(Path, own_files)]
        if any(rig.annotation_files for rig in self._recipe.rigs):
            # Label files may lie outside the bag root.
            recordings = workspace.discover().recordings.values()
            beside += [path for recording in recordings for path in files_beside(self._recipe, recording)]
        self._places = decide.Places(
            recipe=str(recipe_file),
            written=[str(path) for path in paths_written(recipe_file)],
            files=[str(path) for path in files],
            folders=[str(path) for path in folders],
            beside=[str(path) for path in beside],
            bag_root=str(self._recipe.bags.root),
            database=str(database),
            partitions=workspace.names.partitions,
            artifacts=str(self._recipe.store_path / "artifacts"),
        )
        project = workspace_fingerprint(workspace)
        if project is not None:
            with suppress(PlanNeeded):
                self._fingerprints = [mark for _, mark in decide.fingerprints_of(self._places, project)]

    def save(self, plan: Plan, own: Collection[str] = (), remarks: Iterable[Remark] = ()) -> None:
        """Save the snapshot if the plan has nothing to do; else remove the last one.

        Args:
            plan: the state of our assets.
            own: the user's assets, which are up to date.
            remarks: what a build with nothing to do reports.
        """
        bags = plan.bags.values()
        is_waiting = any(FOR_NOW in reason for reason in plan.excluded.values())
        if self._fingerprints is None or is_waiting or not all(bag.settled for bag in bags):
            decide.forget_note(self._recipe.state)
            return
        skipped = sum(bag.skipped is not None for bag in bags)
        counts = f"{len(plan.bags) - skipped} fresh" + (f", {skipped} skipped" if skipped else "")
        decide.note_nothing_to_do(
            self._recipe.state,
            self._places,
            self._fingerprints,
            artifacts={digest for bag in bags for digest in bag.artifacts},
            published=[*dataset_code_versions(self._recipe)],
            lines=[
                *remark_lines(remarks),
                f"{counts}: nothing to do",
                *(f"dataset: {folder} (up to date)" for folder in dataset_folders(self._recipe).values()),
                *([f"{', '.join(own)}: up to date"] if own else ()),
            ],
        )
